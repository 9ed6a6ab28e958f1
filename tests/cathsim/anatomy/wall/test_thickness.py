"""Walls: as thick as tissue between lumens, without hollows, with relief."""

import numpy as np
import pytest

from cathsim.anatomy import VesselTree
from cathsim.anatomy.distance_grid import OUTSIDE, SignedDistanceGrid
from cathsim.anatomy.lumen import build_lumen
from cathsim.anatomy.wall.relief import WallRelief, raise_relief
from cathsim.anatomy.wall.thickness import (
    LARGEST,
    THINNEST,
    fill_chambers,
    thicken_between_lumens,
    walls_between_lumens,
)
from cathsim.lattice.node_set import NodeSet
from cathsim.presets import WIRE_RADIUS
from tests.cathsim.anatomy.wall.tubes import SPACING, tubes, wall_at


@pytest.mark.parametrize("between", [0.6e-3, 2.5e-3])
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


def test_the_balls_of_a_wall_lie_halfway_between_the_lumens() -> None:
    centres, radii = walls_between_lumens(tubes((-0.006, 0.005), (0.006, 0.005)), 0.003)
    assert len(centres) > 50
    assert np.abs(centres[:, 0]).max() < 0.3e-3
    assert radii.min() == pytest.approx(1e-3, abs=0.2e-3)
    assert radii.max() < 1.6e-3
    assert len(walls_between_lumens(tubes((0.0, 0.006)), 0.003)[0]) == 0


def vessel_and_ball(radius: float, away: float) -> SignedDistanceGrid:
    """A tube of 5 mm of radius along z, and a hollow ball whose middle lies `away` (m) from its axis."""
    x, y, z = np.meshgrid(
        np.arange(-0.008, 0.0221, SPACING), np.arange(-0.01, 0.0101, SPACING), np.arange(0, 0.04, SPACING),
        indexing="ij",
    )  # fmt: skip
    ball = radius - np.sqrt((x - away) ** 2 + y**2 + (z - 0.02) ** 2)
    distance = np.maximum(np.maximum(0.005 - np.hypot(x, y), ball), OUTSIDE)
    return SignedDistanceGrid(distance.astype(np.float32), [-0.008, -0.01, 0.0], SPACING)


def chambers(grid: SignedDistanceGrid) -> int:
    return len(np.unique(NodeSet.where(grid.blocks, lambda values: values > WIRE_RADIUS).parts()))


def test_a_hollow_beside_the_vessel_becomes_wall() -> None:
    grid = vessel_and_ball(2.2e-3, 0.009)
    filled = fill_chambers(grid)
    assert (chambers(grid), chambers(filled)) == (2, 1)
    assert filled.sample([0.009, 0.0, 0.02]) < -2e-3
    assert (filled.values <= grid.values).all()
    tube = grid.coordinates(np.argwhere(grid.values > WIRE_RADIUS))
    tube = tube[tube[:, 0] < 0.006]
    np.testing.assert_array_equal(filled.sample(tube), grid.sample(tube))
    far = grid.coordinates(np.argwhere(np.abs(np.arange(grid.shape[2]) - 20)[None, None, :] > 6 + np.zeros(grid.shape)))
    np.testing.assert_array_equal(filled.sample(far), grid.sample(far))


def test_what_may_be_a_vessel_or_is_rounding_stays() -> None:
    large = vessel_and_ball(4.5e-3, 0.0125)
    assert chambers(large) == 2
    assert fill_chambers(large) is large
    assert 4 / 3 * np.pi * (4.5e-3 - WIRE_RADIUS) ** 3 > LARGEST
    small = vessel_and_ball(1.2e-3, 0.009)  # 7 nodes
    assert chambers(small) == 2
    assert fill_chambers(small) is small
    whole = vessel_and_ball(2.2e-3, 0.006)
    assert chambers(whole) == 1
    assert fill_chambers(whole) is whole


@pytest.fixture(scope="module")
def smooth(tube: VesselTree):
    return build_lumen(tube, resolution=8e-4, fillet_radius=2e-3)


def wall(grid, tube: VesselTree) -> np.ndarray:
    """Distance of the grid's wall from the axis of the tube, on many rays, m."""
    angle, reach = np.arange(48) * 2 * np.pi / 48, np.arange(0.0, 0.02, 1e-4)
    rays = np.stack((np.cos(angle), np.sin(angle), np.zeros(48)), axis=1)
    along = grid.sample(tube.root.points[8:-8, None, None] + reach[:, None] * rays[:, None])
    return reach[np.argmax(along <= 0, axis=-1)]


def test_height_is_that_of_the_relief(smooth, tube: VesselTree) -> None:
    relief = WallRelief(coarse=0.0, fine=3e-4, fine_length=6e-3)
    heights = [wall(raise_relief(smooth, tube, relief, np.random.default_rng(seed)), tube) - 0.006 for seed in range(4)]
    assert np.std(heights) == pytest.approx(3e-4, rel=0.2)
    assert np.mean(heights) == pytest.approx(0.0, abs=1e-4)


def test_no_relief_changes_nothing_and_a_seed_is_one_relief(smooth, tube: VesselTree) -> None:
    flat = raise_relief(smooth, tube, WallRelief(coarse=0.0, fine=0.0), np.random.default_rng(1))
    assert np.array_equal(flat.values, smooth.values)
    one, same, other = (raise_relief(smooth, tube, WallRelief(), np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert np.array_equal(one.values, same.values)
    assert not np.array_equal(one.values, other.values)
    with pytest.raises(ValueError, match=r"fine must lie in 0 to 0\.002 m, got 0\.3; lengths are in metres"):
        WallRelief(fine=0.3)
