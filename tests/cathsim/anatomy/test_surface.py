"""Surfaces: a watertight lumen, a wall cut open at its ends."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from cathsim.anatomy import surface
from cathsim.anatomy.surface import open_ends


def test_the_lumen_mesh_is_watertight_and_holds_the_lumens_volume(phantom):
    mesh = phantom.lumen_mesh
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.body_count == 1
    assert mesh.euler_number == 2, "no handles: vessels do not touch"
    voxels = np.count_nonzero(phantom.grid.values > 0) * phantom.grid.spacing**3
    assert mesh.volume == pytest.approx(voxels, rel=0.01)
    assert np.abs(phantom.grid.sample(mesh.vertices)).max() < 1e-5
    assert phantom.lumen_mesh is mesh


def test_normals_point_out_of_the_lumen(phantom):
    mesh = phantom.lumen_mesh
    probe = mesh.triangles_center[::101] + 1e-3 * mesh.face_normals[::101]
    assert np.mean(phantom.grid.sample(probe) < 0) > 0.999


def test_the_wall_is_a_solid_of_even_thickness_open_at_every_end(phantom):
    wall = phantom.wall_mesh(1.5e-3)
    assert wall.is_watertight
    assert wall.is_winding_consistent
    # A shell round a tree with n openings is a sphere with n - 1 handles, whose Euler number is 2 - 2 (n - 1).
    ends = open_ends(phantom.tree)
    assert len(ends) == 6
    assert wall.euler_number == 2 - 2 * (len(ends) - 1)
    distance = phantom.grid.sample(wall.vertices)
    middle = np.all([np.linalg.norm(wall.vertices - c, axis=1) > r + 5e-3 for c, _, r in ends], axis=0)
    assert np.all((np.abs(distance[middle]) < 5e-5) | (np.abs(distance[middle] + 1.5e-3) < 5e-5))
    area = phantom.lumen_mesh.area - sum(np.pi * r**2 for _, _, r in ends)
    assert wall.volume == pytest.approx(area * 1.5e-3, rel=0.12)


@pytest.mark.parametrize("thickness", [0.0, -1e-3, 1.5])
def test_an_impossible_thickness_is_refused(phantom, thickness):
    with pytest.raises(ValueError, match=r"thickness must lie in \(0, 0.005\] m, got"):
        phantom.wall_mesh(thickness)


def test_surface_made_in_slabs_is_the_same(phantom, monkeypatch):
    whole = phantom.lumen_mesh
    monkeypatch.setattr(surface, "_DENSE", 0)
    for level in (0.0, -1.5e-3):
        pieced = surface.lumen_surface(phantom.grid, level=level)
        assert pieced.is_watertight
        assert pieced.is_winding_consistent
    pieced = surface.lumen_surface(phantom.grid)
    assert len(pieced.faces) == pytest.approx(len(whole.faces), abs=50)  # collapsed ones are rounding
    assert pieced.volume == pytest.approx(whole.volume, rel=1e-6)
    assert cKDTree(whole.vertices).query(pieced.vertices)[0].max() < 1e-4
