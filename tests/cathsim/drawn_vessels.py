"""Vessels from a formula: a sphere, a tube, any signed distance over a cube."""

from collections.abc import Callable
from typing import Any

import numpy as np

from cathsim.anatomy import SignedDistanceGrid
from cathsim.contact.sdf import Vessel

UP = np.array([0.0, 0.0, 1.0])
TUBE_RADIUS = 0.006


def sampled(
    distance: Callable[[np.ndarray], np.ndarray], low: float, high: float, spacing: float, **sheath: Any
) -> Vessel:
    """A vessel over a cube, from a signed distance of points (n, 3); without a sheath by default."""
    axis = np.arange(low, high + spacing / 2, spacing)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    values = distance(points.reshape(-1, 3)).reshape(points.shape[:3])
    grid = SignedDistanceGrid(values, np.full(3, axis[0]), spacing)
    return Vessel(grid, **{"entry": np.zeros(3), "direction": UP, "sheath_radius": 0.0, **sheath})


def sphere(radius: float, spacing: float = 0.001) -> Vessel:
    """The inside of a sphere about the origin."""
    return sampled(lambda p: radius - np.linalg.norm(p, axis=1), -radius - 0.003, radius + 0.003, spacing)


def tube_distance(points: np.ndarray) -> np.ndarray:
    """Inside of a tube along z, closed at both ends."""
    x, y, z = points.T
    return np.minimum(TUBE_RADIUS - np.hypot(x, y), np.minimum(0.045 - z, z + 0.005))


def tube(**sheath: Any) -> Vessel:
    return sampled(tube_distance, -0.010, 0.050, 0.001, **sheath)
