"""Costs between pieces: bending energy against the circle's, gaps, evidence in between."""

from __future__ import annotations

import numpy as np
import pytest

from guide3d.reading.links import LinkSettings, bending_energy, link_costs
from guide3d.reading.ridges import RidgeSettings, find_pieces
from tests.guide3d.reading.drawn_maps import soft_line


@pytest.mark.parametrize("turn", [0.1, 0.5, 1.0])
def test_energy_of_an_arc_is_that_of_the_circle(turn: float) -> None:
    radius = 200.0
    gap = radius * np.array([[np.sin(turn), 1 - np.cos(turn)]])
    energy = bending_energy(np.array([[1.0, 0.0]]), np.array([[np.cos(turn), np.sin(turn)]]), gap, 1e-3)
    assert energy[0] == pytest.approx(turn / radius, rel=0.1)  # curvature^2 times length


def test_a_reversal_costs_more_than_going_on() -> None:
    gap, ahead = np.array([[20.0, 0.0]] * 2), np.array([[1.0, 0.0]] * 2)
    straight, back = bending_energy(ahead, ahead * [[1.0], [-1.0]], gap, 12.0)
    assert straight == pytest.approx(0.0)
    assert back > 0.5


def test_links_prefer_the_piece_ahead_and_weak_evidence() -> None:
    shape = (300, 300)
    lines = [[[20, 150], [100, 150]], [[140, 150], [260, 150]], [[140, 150], [140, 280]]]
    wire = np.max([soft_line(shape, line) for line in lines[:2]] + [soft_line(shape, [[120, 190], [120, 280]])], axis=0)
    costs = {}
    for level in (0.0, 0.1):
        faint = np.maximum(wire, np.float32(level) * soft_line(shape, [[100, 150], [140, 150]]))
        pieces = find_pieces(faint, np.empty((0, 2)), RidgeSettings())
        assert len(pieces) == 3
        leaving = int(np.abs(pieces.ends - [100, 150]).sum(axis=1).argmin())
        first = link_costs(pieces, faint, LinkSettings())[leaving][0]
        assert np.abs(pieces.ends[first[0]] - [140, 150]).max() < 5
        costs[level] = first[1]
    assert costs[0.1] < 0.95 * costs[0.0]


def test_no_link_is_longer_than_allowed() -> None:
    wire = np.maximum(soft_line((300, 300), [[20, 150], [100, 150]]), soft_line((300, 300), [[190, 150], [280, 150]]))
    pieces = find_pieces(wire, np.empty((0, 2)), RidgeSettings())
    assert any(link_costs(pieces, wire, LinkSettings(longest=0.32)))
    assert not any(link_costs(pieces, wire, LinkSettings(longest=0.28)))
