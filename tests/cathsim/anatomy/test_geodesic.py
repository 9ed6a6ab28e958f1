"""Distances along the lumen: known tubes, the field against the centreline graph."""

import numpy as np
import pytest

from cathsim.anatomy.centreline import arc_length
from cathsim.anatomy.geodesic import MARGIN, geodesic_field, graph_distance
from cathsim.anatomy.lumen import build_lumen
from tests.cathsim.anatomy.lumen_report import centreline_path


def test_in_a_straight_tube_it_is_the_straight_distance(tube):
    grid = build_lumen(tube, resolution=1e-3, fillet_radius=2e-3)
    target = np.array([0.0005, 0.0002, 0.0203])
    field = geodesic_field(grid, target)
    rng = np.random.default_rng(1)
    points = rng.uniform([-0.003, -0.003, -0.027], [0.003, 0.003, 0.027], (400, 3))
    found = field.sample(points)
    assert found == pytest.approx(np.linalg.norm(points - target, axis=1), abs=6e-4)


def test_around_a_corner_it_is_the_way_through_the_lumen(tee):
    grid = build_lumen(tee, resolution=1e-3, fillet_radius=1e-4)
    field = geodesic_field(grid, [0.035, 0, 0])
    found = field.sample([0.0, 0.0, 0.035])
    corner = np.array([0.008, 0, 0.004])  # the taut string bends at the ostium's edge
    expected = np.linalg.norm(corner - [0.035, 0, 0]) + np.linalg.norm(corner - [0, 0, 0.035])
    assert found == pytest.approx(expected, rel=0.02)


def test_graph_distance_by_hand(tee):
    assert graph_distance(tee, "bca", 0.03, "aorta", 0.01) == pytest.approx(0.03 + 0.03)
    assert graph_distance(tee, "aorta", [0.0, 0.04, 0.08], "bca", 0.02) == pytest.approx([0.06, 0.02, 0.06])
    assert graph_distance(tee, "bca", 0.01, "bca", 0.035) == pytest.approx(0.025)


def test_centreline_path_joins_both_places(phantom):
    tree = phantom.tree
    target = phantom.targets["rcca"]
    path = centreline_path(tree, ("lcca", 0.06), ("rcca", target.arc))
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert path[0] == pytest.approx(tree["lcca"].point_at(0.06))
    assert path[-1] == pytest.approx(target.position)
    assert steps.max() < 1.2e-3
    assert steps.sum() == pytest.approx(float(graph_distance(tree, "lcca", 0.06, "rcca", target.arc)), rel=0.01)


@pytest.mark.parametrize("target", ["bca", "lcca", "lsa"])
def test_field_agrees_with_the_centreline_graph(phantom, target):
    """Through the lumen it is never longer than along the centreline, and shorter only by what bends allow."""
    place = phantom.targets[target]
    path = centreline_path(phantom.tree, ("aorta", 0.005), (place.branch, place.arc))
    field = phantom.geodesic_distance(path, target)
    graph = arc_length(path[::-1])[::-1]
    assert np.all(field <= 1.01 * graph + 1e-3)
    assert np.all(field >= 0.75 * graph - 1e-3)
    in_branch = np.linspace(phantom.tree.ostium_arc(target) + 0.006, place.arc, 20)
    points = phantom.tree[target].point_at(in_branch)
    assert phantom.geodesic_distance(points, target) == pytest.approx(place.arc - in_branch, abs=1e-3)


def test_it_falls_steadily_along_the_way(phantom):
    place = phantom.targets["lcca"]
    path = centreline_path(phantom.tree, ("aorta", 0.005), (place.branch, place.arc))[::6]
    assert np.all(np.diff(phantom.geodesic_distance(path, "lcca")) < 0)
    assert phantom.geodesic_distance(place.position, "lcca") < phantom.grid.spacing


def test_outside_the_wall_the_nearest_inside_value_counts(phantom):
    mesh = phantom.lumen_mesh
    wall, normal = mesh.triangles_center[::53], mesh.face_normals[::53]
    inside = phantom.geodesic_distance(wall - 1e-3 * normal, "bca")
    for depth in (3e-4, 1e-3, 2.5e-3):
        outside = phantom.geodesic_distance(wall + depth * normal, "bca")
        assert np.percentile(np.abs(outside - inside), 95) < 2.5e-3
    field = phantom.geodesic_field("bca").values
    assert np.isfinite(field).all()
    assert field[phantom.grid.values > -MARGIN].min() >= 0
    assert not field.flags.writeable


def test_a_target_outside_is_refused(tube):
    grid = build_lumen(tube, resolution=1e-3, fillet_radius=2e-3)
    with pytest.raises(ValueError, match="must lie inside the lumen, got"):
        geodesic_field(grid, [0.009, 0, 0])
