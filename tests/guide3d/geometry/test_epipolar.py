"""Epipolar geometry and triangulation on synthetic rigs with known points."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from guide3d.geometry.camera import Camera
from guide3d.geometry.epipolar import EpipolarGeometry, epilines, fundamental_matrix
from guide3d.geometry.triangulation import calibration_covariance, point_covariance, triangulate, triangulate_linear
from guide3d.reconstruction.synthetic_scene import rig


def cameras_and_points(seed: int = 0, count: int = 40) -> tuple[Camera, Camera, np.ndarray]:
    rng = np.random.default_rng(seed)
    return *rig(rng), rng.uniform(-60.0, 60.0, (count, 3))


def test_images_of_one_point_satisfy_the_epipolar_constraint() -> None:
    a, b, X = cameras_and_points()
    F = fundamental_matrix(a, b)
    assert abs(np.linalg.det(F)) < 1e-12
    assert np.linalg.norm(F) == pytest.approx(1.0)
    lines = epilines(F, a.project(X))
    assert np.abs((lines[:, :2] * b.project(X)).sum(1) + lines[:, 2]).max() < 1e-7
    assert np.abs(EpipolarGeometry(a, b).signed_distance(a.project(X), b.project(X))).max() < 1e-9


def test_the_angle_of_the_pencil_measures_the_sampson_distance() -> None:
    a, b, X = cameras_and_points(1)
    F, moved = fundamental_matrix(a, b), b.project(X) + np.array([0.3, 2.0])
    x_a, x_b = (np.column_stack([points, np.ones(len(X))]) for points in (a.project(X), moved))
    gradient = np.hstack([(x_a @ F.T)[:, :2], (x_b @ F)[:, :2]])
    sampson = (x_b * (x_a @ F.T)).sum(1) / np.linalg.norm(gradient, axis=1)
    assert np.allclose(np.abs(EpipolarGeometry(a, b).signed_distance(a.project(X), moved)), np.abs(sampson), rtol=2e-3)


def test_tangent_share_tells_epilines_from_what_crosses_them() -> None:
    a, b, _ = cameras_and_points()
    geometry, middle = EpipolarGeometry(a, b), np.array([[511.5, 511.5]])
    direction = geometry.coordinate(0, middle).gradient[0]
    across = direction / np.linalg.norm(direction)
    along = np.array([-across[1], across[0]])
    assert geometry.tangent_share(0, middle + np.outer([0.0, 50.0], along)) == 1.0
    assert geometry.tangent_share(0, middle + np.outer([0.0, 50.0], across)) == 0.0


def test_one_source_makes_no_epipolar_geometry() -> None:
    a = rig()[0]
    with pytest.raises(ValueError, match="one and the same source"):
        EpipolarGeometry(a, a)
    with pytest.raises(ValueError, match="one and the same source"):
        fundamental_matrix(a, a)


def test_triangulation_returns_the_point() -> None:
    a, b, X = cameras_and_points(2)
    for method in (triangulate_linear, triangulate):
        assert np.abs(method(a, b, a.project(X), b.project(X)) - X).max() < 1e-6
    with pytest.raises(ValueError, match="two lists of as many points"):
        triangulate(a, b, np.zeros((3, 2)), np.zeros((2, 2)))


def test_refined_triangulation_leaves_less_in_the_images() -> None:
    a, b, X = cameras_and_points(3, 400)
    rng = np.random.default_rng(3)
    x_a, x_b = (camera.project(X) + rng.normal(0.0, 2.0, (len(X), 2)) for camera in (a, b))

    def left(points: np.ndarray) -> np.ndarray:
        return ((a.project(points) - x_a) ** 2).sum(1) + ((b.project(points) - x_b) ** 2).sum(1)

    linear, refined = triangulate_linear(a, b, x_a, x_b), triangulate(a, b, x_a, x_b)
    assert (left(refined) <= left(linear) + 1e-9).all()
    error = refined - X
    predicted = point_covariance(a, b, X, 2.0)
    squares = np.einsum("ni,nij,nj->n", error, np.linalg.inv(predicted), error)
    assert squares.mean() == pytest.approx(3.0, rel=0.15)


def test_the_cameras_covariance_moves_points_as_sampled_cameras_do() -> None:
    a, b, X = cameras_and_points(4, 3)
    sd = np.array([3.0, 3.0, 1.0, 4.0, 4.0, 5e-4, 5e-4, 5e-4, 0.3, 0.3, 0.5])
    uncertain = Camera(a.K, a.R, a.t_mm, a.width, a.height, "A", np.diag(sd**2))
    assert np.array_equal(calibration_covariance(a, b, X), np.zeros((3, 3, 3)))
    rng, moved = np.random.default_rng(0), []
    for _ in range(600):
        fx, fy, skew, cx, cy, *rest = rng.normal(0.0, sd)
        K = a.K + np.array([[fx, skew, cx], [0.0, fy, cy], [0.0, 0.0, 0.0]])
        R = Rotation.from_rotvec(rest[:3]).as_matrix() @ a.R
        other = Camera(K, R, a.t_mm + rest[3:], a.width, a.height)
        moved.append(triangulate(a, b, other.project(X), b.project(X)) - X)
    sampled = np.einsum("kni,knj->nij", moved, moved) / len(moved)
    predicted = calibration_covariance(uncertain, b, X)
    assert np.allclose(np.trace(sampled, axis1=1, axis2=2), np.trace(predicted, axis1=1, axis2=2), rtol=0.15)
