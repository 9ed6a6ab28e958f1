"""A vessel's distances and gradients between the nodes of its grid, in its sheath and far outside."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim.anatomy import SignedDistanceGrid
from cathsim.contact.sdf import Vessel
from tests.cathsim.drawn_vessels import TUBE_RADIUS, UP, sampled, sphere, tube


def test_distance_of_a_plane_is_exact() -> None:
    """The spline reproduces linear functions, so a plane's distance is that of the formula to rounding of float32."""
    normal = np.array([0.6, 0.0, 0.8])
    vessel = sampled(lambda p: p @ normal - 0.002, -0.010, 0.010, 0.001)
    points = np.random.default_rng(0).uniform(-0.008, 0.008, (500, 3))
    distance, gradient = vessel.distance(points)
    np.testing.assert_allclose(distance, points @ normal - 0.002, atol=2e-9)
    np.testing.assert_allclose(gradient, np.broadcast_to(normal, gradient.shape), atol=2e-6)


def test_distance_at_nodes_is_the_grids_up_to_its_curvature() -> None:
    """At a node the quadratic spline averages 6/8 of it with 1/8 of its neighbours, along each axis."""
    rng = np.random.default_rng(1)
    values = rng.normal(0, 1e-3, (7, 8, 9)).astype(np.float32)
    vessel = Vessel(SignedDistanceGrid(values, [0.01, 0.02, 0.03], 0.002), np.zeros(3), UP, sheath_radius=0.0)
    weights = np.array([0.125, 0.75, 0.125])
    for i, j, k in rng.integers(1, 6, (50, 3)):
        block = values[i - 1 : i + 2, j - 1 : j + 2, k - 1 : k + 2].astype(float)
        expected = np.einsum("ijk,i,j,k", block, weights, weights, weights)
        point = np.array([0.01, 0.02, 0.03]) + 0.002 * np.array([i, j, k])
        assert vessel.distance(point)[0][0] == pytest.approx(expected, abs=1e-9)


def test_distance_and_normal_of_a_sphere() -> None:
    """Near the wall the spline is off by spacing^2 / 8 x curvature, 2 / radius, and no more."""
    radius = 0.006
    rng = np.random.default_rng(2)
    direction = rng.normal(size=(500, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    rho = radius + rng.uniform(-0.001, 0.001, (500, 1))
    distance, gradient = sphere(radius).distance(rho * direction)
    np.testing.assert_allclose(distance, radius - rho[:, 0], atol=1.4 * 0.001**2 / 8 * 2 / radius)
    normal = gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
    assert np.degrees(np.arccos(np.clip(-(normal * direction).sum(1), -1, 1))).max() < 1.0


def test_distance_and_normal_of_a_tube() -> None:
    rng = np.random.default_rng(3)
    angle, rho = rng.uniform(0, 2 * np.pi, 500), rng.uniform(0.005, 0.007, 500)
    points = np.column_stack((rho * np.cos(angle), rho * np.sin(angle), rng.uniform(0.0, 0.03, 500)))
    distance, gradient = tube().distance(points)
    np.testing.assert_allclose(distance, TUBE_RADIUS - rho, atol=1.4 * 0.001**2 / 8 / 0.005)
    assert np.abs(gradient[:, 2]).max() < 1e-6
    assert (-(gradient[:, 0] * np.cos(angle) + gradient[:, 1] * np.sin(angle))).min() > 0.98


def test_gradient_is_the_distances_derivative() -> None:
    vessel = sphere(0.008)
    points = np.random.default_rng(4).uniform(-0.008, 0.008, (100, 3))
    gradient = vessel.distance(points)[1]
    step = 1e-7
    for axis in range(3):
        shift = step * np.eye(3)[axis]
        slope = (vessel.distance(points + shift)[0] - vessel.distance(points - shift)[0]) / (2 * step)
        np.testing.assert_allclose(gradient[:, axis], slope, atol=1e-5)


def test_sheath_is_a_straight_bore_behind_the_entry() -> None:
    vessel = tube(sheath_radius=0.75e-3, sheath_overlap=0.006)
    behind = np.array([[0.0003, 0.0, -0.5], [0.0, -0.0009, -0.1]])
    distance, gradient = vessel.distance(behind)
    np.testing.assert_allclose(distance, [0.00045, -0.00015], atol=1e-12)
    np.testing.assert_allclose(gradient, [[-1, 0, 0], [0, 1, 0]], atol=1e-12)
    inside = np.array([[0.004, 0.0, 0.020]])
    assert vessel.distance(inside)[0] == pytest.approx(tube().distance(inside)[0])


def test_a_flared_sheath_widens_to_its_mouth_without_a_step() -> None:
    vessel = tube(sheath_radius=0.75e-3, sheath_flare=3e-3)
    heights = np.array([-0.5, -0.0101, -0.0099, -0.007, -0.005])
    distance, gradient = vessel.distance(np.array([[0.0005, 0.0, height] for height in heights]))
    wider = 3e-3 * np.clip(1 + heights / 0.010, 0, 1) ** 2
    slope = 0.6 * np.clip(1 + heights / 0.010, 0, 1)
    np.testing.assert_allclose(distance, (0.00025 + wider) / np.hypot(1, slope), atol=1e-9)
    np.testing.assert_allclose(gradient, np.array([-1 + 0 * slope, 0 * slope, slope]).T / np.hypot(1, slope)[:, None])


@pytest.mark.parametrize(
    ("values", "direction", "message"),
    [
        (np.ones((2, 5, 5)), UP, "at least 3 x 3 x 3 nodes, got shape \\(2, 5, 5\\)"),
        (np.ones((5, 5)), UP, "got shape \\(5, 5\\)"),
        (np.ones((5, 5, 5)), 2 * UP, "direction must be a unit vector"),
        (np.ones((5, 5, 5)), np.array([0.0, 1.0]), "direction must be a unit vector"),
    ],
)
def test_impossible_vessel_is_refused(values: np.ndarray, direction: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Vessel(SignedDistanceGrid(values, np.zeros(3), 0.001), np.zeros(3), direction)


def test_points_of_a_wrong_shape_are_refused() -> None:
    with pytest.raises(ValueError, match=r"shape \(n, 3\), got \(4, 2\)"):
        tube().distance(np.zeros((4, 2)))


def test_far_outside_and_on_the_medial_axis_nothing_is_nan() -> None:
    points = np.array([[0, 0, 0], [0, 0, 0.02], [9, -9, 9], [1e12, 0, 0], [-np.inf, np.inf, 0], [0, 0, -0.5]], float)
    for vessel in (tube(), tube(sheath_radius=0.75e-3), sphere(0.006)):
        distance, gradient = vessel.distance(points)
        assert np.isfinite(distance).all()
        assert np.isfinite(gradient).all()
