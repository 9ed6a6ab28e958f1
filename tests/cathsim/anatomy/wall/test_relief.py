"""Relief of a wall: its height, its limits, its seed."""

import numpy as np
import pytest

from cathsim.anatomy import VesselTree
from cathsim.anatomy.lumen import build_lumen
from cathsim.anatomy.wall.relief import WallRelief, raise_relief


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


def test_narrow_vessels_keep_a_lumen(smooth, tube: VesselTree) -> None:
    high = WallRelief(coarse=2e-3, fine=2e-3)
    radius = wall(raise_relief(smooth, tube, high, np.random.default_rng(1)), tube)
    assert radius.min() > 0.75 * 0.006
    assert radius.max() < 1.27 * 0.006


def test_no_relief_changes_nothing_and_a_seed_is_one_relief(smooth, tube: VesselTree) -> None:
    flat = raise_relief(smooth, tube, WallRelief(coarse=0.0, fine=0.0), np.random.default_rng(1))
    assert np.array_equal(flat.values, smooth.values)
    one, same, other = (raise_relief(smooth, tube, WallRelief(), np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert np.array_equal(one.values, same.values)
    assert not np.array_equal(one.values, other.values)
    with pytest.raises(ValueError, match=r"fine must lie in 0 to 0\.002 m, got 0\.3; lengths are in metres"):
        WallRelief(fine=0.3)
