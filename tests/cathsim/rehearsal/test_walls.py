"""Walls that lie elsewhere: how far, how smoothly, and what stays the scan's."""

from __future__ import annotations

import dataclasses
import gc

import numpy as np
import pytest

from cathsim import Phantom
from cathsim.anatomy.distance_grid import SignedDistanceGrid
from cathsim.rehearsal.walls import displaced_walls, wall_field
from tests.cathsim.anatomy.wall.tubes import tubes, wall_at

FARTHEST = 1e-3  # m


def test_walls_move_by_up_to_the_largest_displacement_in_and_out(type_1: Phantom) -> None:
    copy = displaced_walls(type_1, 3, FARTHEST)
    moved = -type_1.grid.sample(copy.lumen_mesh.vertices)  # outwards
    assert -1.1 * FARTHEST < moved.min() < -0.5 * FARTHEST
    assert 0.5 * FARTHEST < moved.max() < 1.1 * FARTHEST
    assert 0.2 * FARTHEST < np.abs(moved).mean() < 0.7 * FARTHEST


def test_the_field_is_smooth() -> None:
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (5000, 3))
    field, beside = wall_field(points, 5), wall_field(points + np.array([1e-3, 0.0, 0.0]), 5)
    assert np.abs(field).max() <= 1.0
    assert np.abs(beside - field).max() < 0.2  # of the largest displacement, a millimetre further
    assert not np.allclose(field, wall_field(points, 6), atol=0.1)


def test_what_is_not_a_wall_stays_the_scans(type_1: Phantom) -> None:
    copy = displaced_walls(type_1, 3, FARTHEST)
    assert copy.targets == type_1.targets
    assert copy.entries == type_1.entries
    assert copy.geodesic_field("bca") is type_1.geodesic_field("bca")
    far = np.abs(type_1.grid.values) >= 4e-3
    assert np.array_equal(copy.grid.values[far], type_1.grid.values[far])
    assert copy.hash != type_1.hash


def test_a_branch_stays_open(type_1: Phantom) -> None:
    copy = displaced_walls(type_1, 3, 0.02)
    for branch in copy.tree:
        assert copy.grid.sample(branch.points[2:-2]).min() > 0.25 * branch.radius.min(), branch.name


@pytest.mark.parametrize("between", [1.2e-3, 3e-3])
def test_a_wall_between_two_vessels_never_opens(between: float, type_1: Phantom) -> None:
    place = 0.005 + between / 2
    scan = dataclasses.replace(type_1, hash=f"tubes {between}", grid=tubes((-place, 0.005), (place, 0.005)))
    heights, grown = np.arange(0.004, 0.046, 0.002), []
    for seed in range(6):
        grid = displaced_walls(scan, seed, FARTHEST).grid
        assert min(wall_at(grid, height) - wall_at(scan.grid, height) for height in heights) > -0.15e-3
        far = np.stack([np.full_like(heights, place + 0.005), np.zeros_like(heights), heights], axis=1)
        grown.append(grid.sample(far).max() - scan.grid.sample(far).max())
    assert max(grown) > 0.5 * FARTHEST  # on the other side they still grow


def test_a_copy_is_made_once_and_freed(type_1: Phantom, monkeypatch: pytest.MonkeyPatch) -> None:
    copy = displaced_walls(type_1, 9, FARTHEST)
    assert displaced_walls(type_1, 9, FARTHEST) is copy
    assert displaced_walls(type_1, 10, FARTHEST) is not copy
    made: list[int] = []
    monkeypatch.setattr(SignedDistanceGrid, "from_nodes", lambda *a, **k: made.append(1) or type_1.grid)
    del copy
    gc.collect()
    displaced_walls(type_1, 9, FARTHEST)
    assert made == [1]
