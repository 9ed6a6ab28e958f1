"""Reading of one image: the curve in its pixels, negatives, depths, several wires, none."""

from __future__ import annotations

import numpy as np
import pytest

from guide3d import read
from guide3d.reading.curve_reading import Prior
from tests.guide3d.reading.drawn_maps import DarkLineReader, DrawnMaps, bent, maps_of, picture, within
from tests.guide3d.reading.test_curve_reading import ARCH, TWO

READER = DarkLineReader()
MAPS = maps_of(ARCH)


def test_a_curve_is_read_with_its_confidence() -> None:
    reading = read(picture(MAPS), DarkLineReader(MAPS.tip))
    assert reading.found
    assert reading.tip_px is not None
    assert np.hypot(*(reading.tip_px - MAPS.points_px[0])) < 4.0
    assert within(reading.points_px, MAPS.points_px) > 0.99
    assert reading.confidence.shape == reading.sd_px.shape == (len(reading.points_px),)
    assert reading.overall_confidence > 0.8
    assert not reading.messages


@pytest.mark.parametrize("kind", ["inverted", "16 bits", "colour channels", "twice as large"])
def test_other_kinds_of_image_give_the_same_curve(kind: str) -> None:
    image = picture(MAPS)
    scale, said = 1.0, ""
    if kind == "inverted":
        image, said = 255 - image, "was inverted"
    elif kind == "16 bits":
        image, said = image.astype(np.uint16) * 16, "8 bits"
        image[::7, ::7] = 235 * 16  # the brightest level
    elif kind == "colour channels":
        image = np.repeat(image[..., None], 3, axis=2)
    else:
        image, scale, said = np.kron(image, np.ones((2, 2), np.uint8)), 2.0, "was read at 1024 x 1024 px"
    reading = read(image, READER)
    assert within(reading.points_px, (MAPS.points_px + 0.5) * scale - 0.5, 4.0 * scale) > 0.99
    assert any(said in message for message in reading.messages)


def test_no_wire_is_said() -> None:
    rng = np.random.default_rng(0)
    reading = read(rng.integers(160, 200, (300, 300), dtype=np.uint8), READER)
    assert not reading.found
    assert reading.tip_px is None
    assert reading.points_px.shape == (0, 2)
    assert reading.overall_confidence == 0.0
    assert reading.messages == ["no wire was found"]


def test_several_wires_are_said_and_given() -> None:
    both = DrawnMaps(ARCH, np.maximum(MAPS.wire, maps_of(TWO).wire), MAPS.tip)
    reading = read(picture(both), READER)
    assert any("there are 2 wires" in message for message in reading.messages)
    assert len(reading.others) == 1


def test_a_gap_and_a_tip_that_is_not_seen_are_said() -> None:
    reading = read(picture(maps_of(ARCH, gaps=((150, 300),), tip=0.0)), READER)
    assert any("guessed across gaps" in message for message in reading.messages)
    assert any("the tip is uncertain" in message for message in reading.messages)


def test_candidates_can_be_chosen_and_a_prior_chooses() -> None:
    line = bent([(400, 0.0)], (300, 500), 0.0)
    image = picture(maps_of(line, tip=0.0))
    reading = read(image, READER)
    tips = [reading.with_candidate(number).points_px[0] for number in range(len(reading.candidates))]
    assert np.ptp([tip[0] for tip in tips]) > 350
    for ordered in (line, line[::-1]):
        assert np.hypot(*(read(image, READER, Prior(ordered)).points_px[0] - ordered[0])) < 6.0
