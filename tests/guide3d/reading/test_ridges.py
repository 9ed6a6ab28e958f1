"""Pieces of a probability map: what a drawn line, a crossing and a cut give."""

from __future__ import annotations

import numpy as np

from guide3d.reading.ridges import RidgeSettings, find_pieces
from tests.guide3d.reading.drawn_maps import bent, maps_of, soft_line

NO_CUTS = np.empty((0, 2))


def test_a_line_is_one_piece_with_its_directions() -> None:
    line = np.stack([np.linspace(40, 200, 161), np.linspace(60, 60, 161)], axis=1)
    pieces = find_pieces(soft_line((256, 256), line), NO_CUTS, RidgeSettings())
    assert len(pieces) == 1
    assert abs(pieces.lengths[0] - 161) < 8
    order = np.argsort(pieces.ends[:, 0])
    assert np.abs(pieces.ends[order] - [[40, 60], [200, 60]]).max() < 4
    assert np.abs(pieces.outward[order] - [[-1, 0], [1, 0]]).max() < 0.15
    assert not pieces.joined.any()


def test_a_crossing_gives_four_pieces_with_joined_ends() -> None:
    shape = (256, 256)
    across = np.maximum(soft_line(shape, [[20, 128], [230, 128]]), soft_line(shape, [[128, 20], [128, 230]]))
    pieces = find_pieces(across, NO_CUTS, RidgeSettings())
    assert len(pieces) == 4
    assert pieces.joined.reshape(-1, 2).sum(axis=1).tolist() == [1, 1, 1, 1]


def test_a_tip_on_a_wire_cuts_it() -> None:
    line = soft_line((256, 256), [[20, 128], [230, 128]])
    pieces = find_pieces(line, np.array([[90.0, 129.0]]), RidgeSettings())
    assert len(pieces) == 2
    assert np.abs(pieces.ends - [90, 128]).sum(axis=1).min() < 3


def test_weak_marks_and_empty_maps_are_no_pieces() -> None:
    weak = 0.2 * soft_line((256, 256), [[20, 128], [230, 128]])
    assert len(find_pieces(weak, NO_CUTS, RidgeSettings())) == 0
    assert len(find_pieces(np.zeros((256, 256), np.float32), NO_CUTS, RidgeSettings())) == 0
    assert len(find_pieces(weak, NO_CUTS, RidgeSettings(high=0.15))) == 1


def test_a_ring_is_opened() -> None:
    ring = bent([(2 * np.pi * 50, 0.02)], (128, 78), 0.0)
    pieces = find_pieces(maps_of(ring, 256).wire, NO_CUTS, RidgeSettings())
    assert pieces.lengths.sum() > 240
