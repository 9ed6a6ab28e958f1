"""The lumen's distance grid: tubes, caps, ostia, cross sections, interpolation, surfaces."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from cathsim.anatomy import SignedDistanceGrid, surface
from cathsim.anatomy.centreline import LumenPaths
from cathsim.anatomy.distance_grid import in_cylinder, plane_coordinates, wall_distances
from cathsim.anatomy.lumen import build_lumen
from cathsim.anatomy.surface import open_ends


def test_a_straight_tube_has_the_distance_of_a_cylinder_with_flat_caps(tube):
    grid = build_lumen(tube, resolution=1e-3, fillet_radius=2e-3)
    rng = np.random.default_rng(0)
    radius, angle = rng.uniform(0.002, 0.012, 500), rng.uniform(0, 2 * np.pi, 500)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(-0.012, 0.012, 500)], axis=1)
    assert grid.sample(points) == pytest.approx(0.006 - radius, abs=6e-5)
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


@pytest.mark.parametrize("resolution", [0.0, 1.0, float("nan")])
def test_an_impossible_resolution_is_refused(tee, resolution):
    with pytest.raises(ValueError, match=r"resolution must lie in \[0.0003, 0.0032\] m .*, got"):
        build_lumen(tee, resolution=resolution, fillet_radius=2e-3)


SLOPE = np.array([0.5, -0.3, 0.2])


@pytest.fixture(scope="module")
def linear() -> SignedDistanceGrid:
    origin = np.array([0.01, -0.02, 0.03])
    axes = np.meshgrid(np.arange(6), np.arange(7), np.arange(8), indexing="ij")
    points = origin + np.stack(axes, axis=-1) * 2e-3
    return SignedDistanceGrid((points @ SLOPE).astype(np.float32), origin, 2e-3)


def test_trilinear_interpolation_reproduces_a_linear_field(linear):
    rng = np.random.default_rng(0)
    low, high = linear.bounds
    points = rng.uniform(low, high, (4, 50, 3))
    assert linear.sample(points).shape == (4, 50)
    assert linear.sample(points) == pytest.approx(points @ SLOPE, abs=1e-8)
    inner = rng.uniform(low + 2e-3, high - 2e-3, (50, 3))
    assert linear.gradient(inner) == pytest.approx(np.broadcast_to(SLOPE, (50, 3)), abs=1e-5)


def test_bad_input_is_refused(linear):
    nodes = {"shape": (4, 4, 4), "origin": np.zeros(3), "spacing": 1e-3}
    for call, message in (
        (lambda: linear.sample([0.0, 1.0]), r"points must have shape \(..., 3\), got \(2,\)"),
        (lambda: SignedDistanceGrid(np.zeros((1, 4, 4), np.float32), np.zeros(3), 1e-3), "at least 2 x 2 x 2"),
        (lambda: SignedDistanceGrid(np.zeros((4, 4, 4), np.float32), np.zeros(3), 0.0), "spacing must be positive"),
        (lambda: linear.values.fill(1.0), "read-only"),
        (lambda: SignedDistanceGrid.from_nodes([[1, 1, 1]], [-0.02], **nodes), r"below that outside, -0\.01 m"),
        (lambda: SignedDistanceGrid.from_nodes([[1, 1, 1]], [0.02], **nodes, outside=0.0), "must be negative"),
    ):
        with pytest.raises(ValueError, match=message):
            call()


def test_a_grid_of_the_nodes_near_a_lumen_is_that_of_the_dense_array():
    axes = np.meshgrid(*[np.arange(-20, 21) * 1e-3] * 3, indexing="ij")
    values = np.maximum(6e-3 - np.sqrt(sum(x**2 for x in axes)), -0.01).astype(np.float32)
    dense = SignedDistanceGrid(values, [-0.02] * 3, 1e-3)
    near = np.argwhere(values > -0.01)
    sparse = SignedDistanceGrid.from_nodes(near, values[tuple(near.T)], values.shape, [-0.02] * 3, 1e-3)
    points = np.random.default_rng(1).uniform(-0.022, 0.022, (2000, 3))
    assert np.array_equal(sparse.sample(points), dense.sample(points))
    assert np.array_equal(sparse.values, values)
    assert np.array_equal(sparse.inside_box(), [[15] * 3, [25] * 3])
    assert np.array_equal(sparse.silhouette(1), values.max(axis=1))
    assert sparse.thickness(2)[20, 20] == pytest.approx(0.012, abs=1e-5)
    assert np.array_equal(sparse.offset(1e-3).moved([0, 0, 0.01]).values, values + np.float32(1e-3))
    assert sparse.moved([0, 0, 0.01]).sample([0, 0, 0.01]) == pytest.approx(6e-3)
    assert np.array_equal(sparse.coarser(3).values, values[::3, ::3, ::3])
    assert np.array_equal(sparse.coarser(3).coordinates([1, 2, 3]), sparse.coordinates([3, 6, 9]))


def test_cross_sections():
    spacing = 1e-3
    x, y, _ = np.meshgrid(*[np.arange(-15, 16) * spacing] * 3, indexing="ij")
    grid = SignedDistanceGrid(6e-3 - np.hypot(x, y), np.full(3, -15e-3), spacing)
    reach, rays = wall_distances(grid, np.array([[1e-3, 0, 0]]), np.array([[0, 0, 1.0]]), rays=24)
    assert reach.shape == (24, 1)
    ends = np.array([1e-3, 0, 0]) + reach[..., None] * rays
    assert np.abs(np.linalg.norm(ends, axis=-1) - 6e-3).max() < 1e-4


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


def test_centrelines_of_a_tee():
    inside = np.zeros((60, 30, 90), dtype=bool)
    x, y, z = np.indices(inside.shape)
    inside |= ((x - 15) ** 2 + (y - 15) ** 2 <= 100) & (z >= 5) & (z < 85)
    inside |= ((z - 45) ** 2 + (y - 15) ** 2 <= 25) & (x >= 15) & (x < 58)
    paths = LumenPaths(inside, np.zeros(3), 1e-3)
    ends = paths.ends()
    assert len(ends) == 3
    assert sorted(int(end[2] > 45) + int(end[2] > 20) for end in ends) == [0, 1, 2]
    (way,) = paths.ways(ends[0], ends[1:2])
    assert (way[0] == ends[0]).all()
    assert (way[-1] == ends[1]).all()
    middle = way[(np.abs(way[:, 2] - 25) < 8)]
    assert np.abs(middle[:, :2] - 15).max() <= 2  # it keeps to the tube's axis


def test_points_in_a_cylinder_are_those_of_its_heights_and_distances() -> None:
    rng = np.random.default_rng(0)
    points, centre, normal = rng.normal(size=(2001, 3)), rng.normal(size=3), np.array([0.6, 0.0, 0.8])
    height, aside = plane_coordinates(points, centre, normal)
    rows, over = in_cylinder(points, centre, normal, (-0.7, 0.4), 1.1)
    assert 50 < len(rows) < 1000
    np.testing.assert_array_equal(rows, np.flatnonzero((height > -0.7) & (height < 0.4) & (aside < 1.1)))
    np.testing.assert_array_equal(over, height[rows])
