"""Small hollows in the wall: filled, and nothing else changed."""

from __future__ import annotations

import numpy as np

from cathsim.anatomy.distance_grid import OUTSIDE, SignedDistanceGrid
from cathsim.anatomy.wall.thickness import LARGEST, fill_chambers
from cathsim.lattice.node_set import NodeSet
from cathsim.presets import WIRE_RADIUS

SPACING = 1e-3


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
