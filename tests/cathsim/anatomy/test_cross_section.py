"""Cross sections of a lumen."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim.anatomy import SignedDistanceGrid
from cathsim.anatomy.cross_section import plane_coordinates, wall_distances


def test_cross_sections():
    spacing = 1e-3
    x, y, _ = np.meshgrid(*[np.arange(-15, 16) * spacing] * 3, indexing="ij")
    grid = SignedDistanceGrid(6e-3 - np.hypot(x, y), np.full(3, -15e-3), spacing)
    reach, rays = wall_distances(grid, np.array([[1e-3, 0, 0]]), np.array([[0, 0, 1.0]]), rays=24)
    assert reach.shape == (24, 1)
    ends = np.array([1e-3, 0, 0]) + reach[..., None] * rays
    assert np.abs(np.linalg.norm(ends, axis=-1) - 6e-3).max() < 1e-4


def test_plane_coordinates_are_height_and_distance_from_the_axis():
    height, aside = plane_coordinates(np.array([[0.0, 3.0, 6.0], [4.0, 0.0, 1.0]]), np.array([0.0, 0, 1]), np.eye(3)[2])
    assert height == pytest.approx([5.0, 0.0])
    assert aside == pytest.approx([3.0, 4.0])
