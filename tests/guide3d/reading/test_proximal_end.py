"""Continuation of a wire to the border of the field."""

from __future__ import annotations

import numpy as np

from guide3d.opencv import cv2
from guide3d.reading.path_drawing import ProximalEndSettings, to_border
from tests.guide3d.reading.drawn_maps import soft_line

SHAPE = (400, 400)
FAR = ProximalEndSettings(longest=0.4)
LINE = np.stack([np.arange(99.0, 301.0), np.full(202, 200.0)], axis=1)


def _away(outside_from: int = 400) -> np.ndarray:
    exposed = np.ones((50, 50), np.uint8)
    exposed[:, outside_from // 8 :] = 0
    return np.asarray((cv2.distanceTransform(np.pad(exposed, 1), cv2.DIST_L2, 3)[1:-1, 1:-1] - 0.5) * 8, np.float32)


def test_a_wire_goes_straight_on_where_nothing_is_seen() -> None:
    line = to_border(LINE, np.zeros(SHAPE, np.float32), _away(), 8, FAR)
    assert 390 < line[-1, 0] <= 400
    assert abs(line[-1, 1] - 200) < 1.0
    assert np.array_equal(line[: len(LINE)], LINE)


def test_faint_evidence_bends_it() -> None:
    rest = np.stack([300 + np.arange(100.0), 200 + 0.0012 * np.arange(100.0) ** 2], axis=1)
    line = to_border(LINE, 0.4 * soft_line(SHAPE, rest), _away(), 8, FAR)
    assert abs(line[-1, 1] - 212) < 4.0


def test_it_ends_with_the_field_and_not_beyond_its_reach() -> None:
    empty = np.zeros(SHAPE, np.float32)
    assert abs(to_border(LINE, empty, _away(352), 8, FAR)[-1, 0] - 350) < 10
    for longest in (0.0, 0.15):
        assert len(to_border(LINE, empty, _away(), 8, ProximalEndSettings(longest=longest))) == len(LINE)


def test_no_more_than_a_third_of_the_path_is_guessed() -> None:
    beginning = LINE[:190]
    assert len(to_border(beginning, np.zeros(SHAPE, np.float32), _away(), 8, FAR)) == 190
