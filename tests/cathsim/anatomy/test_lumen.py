"""The lumen's signed distance: known tubes, flat caps, rounded ostia, slope, padding."""

import numpy as np
import pytest

from cathsim.anatomy.lumen import OUTSIDE, build_lumen
from cathsim.anatomy.surface import open_ends


def test_a_straight_tube_has_the_distance_of_a_cylinder(tube):
    grid = build_lumen(tube, resolution=1e-3, fillet_radius=2e-3)
    rng = np.random.default_rng(0)
    radius, angle = rng.uniform(0.002, 0.012, 500), rng.uniform(0, 2 * np.pi, 500)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(-0.012, 0.012, 500)], axis=1)
    assert grid.sample(points) == pytest.approx(0.006 - radius, abs=6e-5)


def test_open_ends_are_closed_by_flat_caps(tube):
    grid = build_lumen(tube, resolution=1e-3, fillet_radius=2e-3)
    for x in (0.0, 0.002, -0.003):
        assert grid.sample([x, 0, 0.029]) == pytest.approx(0.001, abs=1e-5)
        assert grid.sample([x, 0, 0.0315]) == pytest.approx(-0.0015, abs=1e-5)
        assert grid.sample([x, 0, -0.0315]) == pytest.approx(-0.0015, abs=1e-5)


def test_ostia_are_rounded_on_the_lumen_side_and_only_there(tee):
    sharp = build_lumen(tee, resolution=5e-4, fillet_radius=1e-4)
    round_ = build_lumen(tee, resolution=5e-4, fillet_radius=2.5e-3)
    crotch = [0.008, 0, 0.004]
    assert abs(sharp.sample(crotch)) < 3e-4
    # A fillet of radius R between walls at right angles moves the edge by R (sqrt 2 - 1).
    assert round_.sample(crotch) == pytest.approx(2.5e-3 * (np.sqrt(2) - 1), rel=0.1)
    away = [[-0.007, 0, 0], [0.03, 0.003, 0], [0.0, 0.0075, 0.03]]
    assert round_.sample(away) == pytest.approx(sharp.sample(away), abs=1e-6)


def test_slope_is_one_at_the_wall(phantom):
    vertices = phantom.lumen_mesh.vertices
    for centre, _, radius in open_ends(phantom.tree):
        vertices = vertices[np.linalg.norm(vertices - centre, axis=1) > radius + 3e-3]
    slope = np.linalg.norm(phantom.grid.gradient(vertices), axis=1)
    assert np.percentile(np.abs(slope - 1), 99) < 0.05
    assert np.abs(slope - 1).max() < 0.3


def test_outside_points_are_pushed_back(phantom):
    """Walking up the gradient from a few millimetres outside ends in the lumen."""
    mesh = phantom.lumen_mesh
    outside = mesh.triangles_center[::97] + 3e-3 * mesh.face_normals[::97]
    outside = outside[phantom.grid.sample(outside) < -1e-3]
    assert len(outside) > 500
    for _ in range(40):
        value = phantom.grid.sample(outside)
        step = np.where(value < 2e-4, np.minimum(-value + 3e-4, 5e-4), 0.0)
        outside = outside + step[:, None] * phantom.grid.gradient(outside)
    assert phantom.grid.sample(outside).min() > 0


def test_grid_is_padded_clamped_and_in_c_order(phantom):
    values = phantom.grid.values
    assert values.dtype == np.float32
    assert values.flags.c_contiguous
    assert values.min() == np.float32(OUTSIDE)
    inside = np.argwhere(values > 0)
    assert inside.min() >= 6
    assert (np.array(values.shape) - 1 - inside.max(axis=0)).min() >= 6
    assert np.isfinite(values).all()


def test_narrow_branches_keep_their_radius(phantom):
    for name in ("lcca", "rcca", "lsa", "rsa"):
        branch = phantom.tree[name]
        arc = np.linspace(0.6 * branch.length, branch.length - 0.008, 12)
        tangent = branch.tangent_at(arc)
        first = np.cross(tangent, [0.1, 1.0, 0.2])
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        second = np.cross(tangent, first)
        for angle in np.linspace(0, 2 * np.pi, 9)[:-1]:
            aside = np.cos(angle) * first + np.sin(angle) * second
            wall = branch.point_at(arc) + branch.radius_at(arc)[:, None] * aside
            assert np.abs(phantom.grid.sample(wall)).max() < 1e-4


def test_same_tree_same_grid(tee):
    first = build_lumen(tee, resolution=1e-3, fillet_radius=2e-3)
    assert np.array_equal(first.values, build_lumen(tee, resolution=1e-3, fillet_radius=2e-3).values)


@pytest.mark.parametrize("resolution", [0.0, -1e-3, 1.0, float("nan")])
def test_an_impossible_resolution_is_refused(tee, resolution):
    with pytest.raises(ValueError, match=r"resolution must lie in \[0.0003, 0.0032\] m .*, got"):
        build_lumen(tee, resolution=resolution, fillet_radius=2e-3)
