"""Polylines of paths: pieces in order, bridges, and the tip of the tip map."""

from __future__ import annotations

import numpy as np
import pytest

from guide3d.reading.path_drawing import path_line, to_tip
from guide3d.reading.path_search import Path
from guide3d.reading.ridges import RidgeSettings, find_pieces
from tests.guide3d.reading.drawn_maps import soft_line

LINE = np.stack([np.arange(100.0, 201.0), np.full(101, 50.0)], axis=1)


def test_pieces_are_joined_in_the_order_of_the_path() -> None:
    shape = (200, 400)
    wire = np.maximum(soft_line(shape, [[40, 100], [150, 100]]), soft_line(shape, [[200, 100], [360, 100]]))
    pieces = find_pieces(wire, np.empty((0, 2)), RidgeSettings())
    first, second = (int(np.abs(pieces.ends - [x, 100]).sum(axis=1).argmin()) for x in (360, 150))
    line = path_line(pieces, Path(0.0, (first, second)))
    assert (np.diff(line[:, 0]) < 0).all()
    assert np.hypot(*np.diff(line, axis=0).T).max() < 8.0
    assert abs(np.ptp(line[:, 0]) - 320) < 8


@pytest.mark.parametrize(("place", "first"), [((92.0, 51.0), 92.0), ((110.0, 50.0), 110.0)])
def test_the_beginning_moves_to_a_near_peak(place: tuple[float, float], first: float) -> None:
    line, height = to_tip(LINE, np.array([place]), np.array([0.8]), 14.0)
    assert height == 0.8
    assert line[0, 0] == first
    assert (np.diff(line[:, 0]) > 0).all()


def test_a_far_peak_changes_nothing() -> None:
    for places in (np.empty((0, 2)), np.array([[160.0, 90.0]])):
        line, height = to_tip(LINE, places, np.full(len(places), 0.9), 14.0)
        assert height == 0.0
        assert np.array_equal(line, LINE)
