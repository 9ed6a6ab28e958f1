"""Walls between lumens: as thick as tissue is, and everything else as it was."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim.anatomy.distance_grid import SignedDistanceGrid
from cathsim.anatomy.wall.thickness import THINNEST, thicken_between_lumens, walls_between_lumens
from tests.cathsim.anatomy.wall.tubes import LENGTH, SPACING, tubes, wall_at


@pytest.mark.parametrize("between", [0.6e-3, 1.4e-3, 2.5e-3])
def test_a_thin_wall_is_filled_from_both_sides_and_nothing_else_changes(between: float) -> None:
    place = 0.005 + between / 2
    grid = tubes((-place, 0.005), (place, 0.005))
    thick = thicken_between_lumens(grid)
    assert wall_at(grid, 0.025) < between + 0.3e-3
    assert wall_at(thick, 0.025) == pytest.approx(THINNEST, abs=0.25e-3)
    lost = [
        grid.sample([x, 0.0, 0.025]) - thick.sample([x, 0.0, 0.025]) for x in (-0.001 - place / 2, place / 2 + 0.001)
    ]
    assert lost[0] == pytest.approx(lost[1], abs=0.1e-3)
    away = grid.coordinates(np.argwhere(grid.values > -0.002))
    away = away[np.abs(away[:, 0]) > place + 0.001]
    np.testing.assert_array_equal(grid.sample(away), thick.sample(away))
    np.testing.assert_array_equal(thick.origin, grid.origin)
    assert thick.shape == grid.shape


def test_a_wall_that_is_thick_enough_stays_and_so_does_a_single_vessel() -> None:
    for grid in (tubes((-0.0067, 0.005), (0.0067, 0.005)), tubes((0.0, 0.006))):
        assert thicken_between_lumens(grid) is grid


def test_a_narrow_vessel_keeps_its_width() -> None:
    grid = tubes((-0.0025, 0.002), (0.0055, 0.005))  # 1 mm between one of 4 mm and one of 10 mm
    thick = thicken_between_lumens(grid)
    x = np.arange(-0.008, 0.0, 2e-5)
    line = np.stack([x, np.zeros_like(x), np.full_like(x, 0.025)], axis=1)
    widths = [np.count_nonzero(one.sample(line) > 0) * 2e-5 for one in (grid, thick)]
    assert widths[1] == pytest.approx(widths[0], abs=0.2e-3)
    assert 1.5e-3 < wall_at(thick, 0.025) < 2.5e-3  # what the wide one gives


def test_a_low_ridge_stays_and_the_wall_of_a_carina_is_thick_up_to_its_edge() -> None:
    carina = tubes((-0.0053, 0.005), (0.0053, 0.005), joined_below=0.015)
    thick = thicken_between_lumens(carina)
    assert all(wall_at(thick, height) == pytest.approx(THINNEST, abs=0.3e-3) for height in (0.02, 0.03, 0.04))
    assert wall_at(thick, 0.012) == 0.0
    x, y, z = np.meshgrid(*(np.arange(-0.012, 0.0121, SPACING),) * 2, np.arange(0, LENGTH, SPACING), indexing="ij")
    vessel = 0.008 - np.hypot(x, y)
    ridge = np.maximum(np.abs(z - 0.025) - 0.5e-3, 0.006 - np.hypot(x, y))  # a ring of 2 mm, 1 mm thick
    grid = SignedDistanceGrid(np.minimum(vessel, ridge).astype(np.float32), [-0.012, -0.012, 0.0], SPACING)
    assert thicken_between_lumens(grid) is grid


def test_the_balls_of_a_wall_lie_halfway_between_the_lumens() -> None:
    centres, radii = walls_between_lumens(tubes((-0.006, 0.005), (0.006, 0.005)), 0.003)
    assert len(centres) > 50
    assert np.abs(centres[:, 0]).max() < 0.3e-3
    assert radii.min() == pytest.approx(1e-3, abs=0.2e-3)
    assert radii.max() < 1.6e-3
    assert len(walls_between_lumens(tubes((0.0, 0.006)), 0.003)[0]) == 0
