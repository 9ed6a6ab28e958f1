"""Where vessels end: the wide one of two that go on in each other."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_dilation, distance_transform_edt

from cathsim.anatomy.mesh.cavity import Cavity
from cathsim.anatomy.mesh.ends import end_before

SPACING = 0.7e-3
WIDE, LENGTH = 5e-3, 0.03  # m
MIDDLE = np.array([0.01, 0.01])
BESIDE = 2e-3  # m from the wide vessel's middle to the narrow one's


def _cavity(narrow: float) -> Cavity:
    """A wide straight vessel along z from which one of another radius (m) goes on."""
    grid = np.stack(np.meshgrid(*[np.arange(30)] * 2, np.arange(100), indexing="ij"), axis=-1) * SPACING
    across = np.linalg.norm(grid[..., :2] - MIDDLE, axis=-1)
    beside = np.linalg.norm(grid[..., :2] - MIDDLE - [BESIDE, 0.0], axis=-1)
    z = grid[..., 2]
    lumen = ((across < WIDE) & (z < LENGTH)) | ((beside < narrow) & (z < 2 * LENGTH) & (z > 0.5 * LENGTH))
    wall = binary_dilation(lumen, np.ones((3, 3, 3))) & ~lumen
    return Cavity(lumen, wall, np.zeros(3), SPACING, "closed lumen", WIDE)


def _way(cavity: Cavity, until: float) -> tuple[np.ndarray, np.ndarray]:
    z = np.arange(2 * SPACING, until, SPACING)
    x = np.where(z < 0.9 * LENGTH, 0.0, BESIDE)
    points = np.stack([MIDDLE[0] + x, np.full(len(z), MIDDLE[1]), z], axis=1)
    depth = distance_transform_edt(cavity.inside) * SPACING
    return points, depth[tuple(cavity.index(points).T)]


def test_a_wide_vessel_ends_where_a_way_goes_on_in_a_narrow_one():
    cavity = _cavity(1.2e-3)
    end = end_before(cavity, *_way(cavity, 1.9 * LENGTH))
    assert end is not None
    assert abs(end.centre[2] - LENGTH) < 4 * SPACING
    assert np.linalg.norm(end.centre[:2] - MIDDLE) < 2 * SPACING
    assert abs(end.radius - WIDE) < 2 * SPACING
    assert end.normal[2] > 0.95


def test_no_wide_vessel_ends_on_a_way_that_goes_on_or_stops_in_it():
    wide = _cavity(4e-3)
    assert end_before(wide, *_way(wide, 1.9 * LENGTH)) is None
    cavity = _cavity(1.2e-3)
    assert end_before(cavity, *_way(cavity, LENGTH)) is None
