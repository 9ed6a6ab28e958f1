"""Tubes side by side, as grids of distances, and the wall between them."""

import numpy as np

from cathsim.anatomy.distance_grid import OUTSIDE, SignedDistanceGrid

SPACING = 1e-3
LENGTH = 0.05  # m of the tubes, along z


def tubes(*tubes_given: tuple[float, float], joined_below: float = 0.0) -> SignedDistanceGrid:
    """Tubes along z at places x with radii, m; below a height they are one lumen."""
    x, y, z = np.meshgrid(
        np.arange(-0.02, 0.0201, SPACING), np.arange(-0.012, 0.0121, SPACING), np.arange(0, LENGTH, SPACING),
        indexing="ij",
    )  # fmt: skip
    distance = np.max([radius - np.hypot(x - place, y) for place, radius in tubes_given], axis=0)
    if joined_below:
        distance = np.maximum(distance, np.minimum(0.009 - np.hypot(x, y), joined_below - z))
    return SignedDistanceGrid(np.maximum(distance, OUTSIDE).astype(np.float32), [-0.02, -0.012, 0.0], SPACING)


def wall_at(grid: SignedDistanceGrid, height: float) -> float:
    """Thickness (m) of the wall across x = 0."""
    x = np.arange(-0.004, 0.004, 2e-5)
    outside = grid.sample(np.stack([x, np.zeros_like(x), np.full_like(x, height)], axis=1)) <= 0
    return float(np.count_nonzero(outside) * 2e-5)
