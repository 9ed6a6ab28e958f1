"""Points in space from their images in two views: linear, refined, and how sure they are."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from guide3d.geometry.camera import Camera
from guide3d.geometry.polyline import Array


def triangulate_linear(camera_a: Camera, camera_b: Camera, points_a: ArrayLike, points_b: ArrayLike) -> Array:
    """Triangulates pairs of points by the linear equations x x (P X) = 0; gives (n, 3) mm, world.

    Args:
        points_a, points_b: (n, 2) undistorted px of the same points.

    Raises:
        ValueError: the lists differ in length or are not (n, 2).

    Source:
        Hartley and Zisserman, Multiple View Geometry (2004), section 12.2.
    """
    a, b = _pairs(points_a, points_b)
    rows = []
    for camera, points in ((camera_a, a), (camera_b, b)):
        P = camera.P / np.linalg.norm(camera.P[2, :3])
        for axis in (0, 1):
            # an equation of unit length is a distance from a plane through the source, in mm
            equation = points[:, axis, None] * P[2] - P[axis]
            rows.append(equation / np.linalg.norm(equation[:, :3], axis=1, keepdims=True))
    A = np.stack(rows, axis=1)
    normal = A[:, :, :3].transpose(0, 2, 1) @ A[:, :, :3]
    right = -A[:, :, :3].transpose(0, 2, 1) @ A[:, :, 3:]
    return np.asarray(np.linalg.solve(normal, right)[..., 0])


_OBJECT_MM = (150.0, 3500.0)  # from an X-ray source to what both see: 500 to 1200 mm in a C-arm
_LEAST_ANGLE = 0.1  # sine of the angle between central rays that tells where they meet


def require_millimetres(camera_a: Camera, camera_b: Camera) -> None:
    """Refuses cameras whose central rays meet too near or too far for millimetres.

    Raises:
        ValueError: they have another unit.
    """
    cameras = (camera_a, camera_b)
    middles = [np.array([[camera.width - 1, camera.height - 1]]) / 2 for camera in cameras]
    rays = [camera.rays(middle)[0] for camera, middle in zip(cameras, middles, strict=True)]
    if np.linalg.norm(np.cross(*rays)) < _LEAST_ANGLE:
        return
    (met,) = triangulate_linear(camera_a, camera_b, *middles)
    away = float(np.mean([np.linalg.norm(met - camera.centre_mm) for camera in cameras]))
    if not _OBJECT_MM[0] <= away <= _OBJECT_MM[1]:
        raise ValueError(
            f"the views meet {away:.4g} mm from the X-ray sources, expected {_OBJECT_MM[0]:g} to {_OBJECT_MM[1]:g} mm: "
            "is the cameras' unit of length another one?"
        )


def triangulate(
    camera_a: Camera, camera_b: Camera, points_a: ArrayLike, points_b: ArrayLike, iterations: int = 3
) -> Array:
    """Triangulates pairs of points: linear first, then the least squared distance in the images by Gauss-Newton.

    As `triangulate_linear`, with `iterations` steps; three settle to well below a micrometre.
    """
    a, b = _pairs(points_a, points_b)
    X = triangulate_linear(camera_a, camera_b, a, b)
    for _ in range(iterations):
        J = np.concatenate([projection_jacobian(camera_a, X), projection_jacobian(camera_b, X)], axis=1)
        residual = np.concatenate([a - camera_a.project(X), b - camera_b.project(X)], axis=1)[..., None]
        Jt = J.transpose(0, 2, 1)
        X = X + np.linalg.solve(Jt @ J, Jt @ residual)[..., 0]
    return X


def projection_jacobian(camera: Camera, points_mm: ArrayLike) -> Array:
    """Returns the derivative (n, 2, 3) px/mm of the projection of points (n, 3) mm."""
    points = np.asarray(points_mm, dtype=float)
    P = camera.P
    seen = points @ P[:, :3].T + P[:, 3]
    pixels = seen[:, :2] / seen[:, 2:]
    return np.asarray((P[:2, :3] - pixels[:, :, None] * P[2, :3]) / seen[:, 2, None, None])


def point_covariance(camera_a: Camera, camera_b: Camera, points_mm: ArrayLike, noise_px: float) -> Array:
    """Returns the covariance (n, 3, 3) mm^2 of triangulated points (n, 3) mm for `noise_px` in each coordinate."""
    points = np.asarray(points_mm, dtype=float)
    J = np.concatenate([projection_jacobian(camera_a, points), projection_jacobian(camera_b, points)], axis=1)
    return np.asarray(noise_px**2 * np.linalg.inv(J.transpose(0, 2, 1) @ J))


def calibration_covariance(camera_a: Camera, camera_b: Camera, points_mm: ArrayLike) -> Array:
    """Returns what both cameras' own covariances add to the covariance (n, 3, 3) mm^2 of points (n, 3) mm.

    It is common to all points of a curve: it moves the curve as a whole. Cameras without a covariance add nothing.
    """
    points = np.asarray(points_mm, dtype=float)
    J = np.concatenate([projection_jacobian(camera_a, points), projection_jacobian(camera_b, points)], axis=1)
    back = np.linalg.pinv(J)
    total = np.zeros((len(points), 3, 3))
    for view, camera in enumerate((camera_a, camera_b)):
        if camera.covariance is None:
            continue
        moved = back[:, :, 2 * view : 2 * view + 2] @ _parameter_jacobian(camera, points)
        total += moved @ camera.covariance @ moved.transpose(0, 2, 1)
    return total


def _parameter_jacobian(camera: Camera, points: Array) -> Array:
    """Derivative (n, 2, 11) of the projection by the camera's parameters, in the order of Camera.covariance."""
    steps = np.array([1e-2] * 5 + [1e-7] * 3 + [1e-3] * 3)
    columns = []
    for k, step in enumerate(steps):
        change = np.zeros(11)
        change[k] = step
        fx, fy, skew, cx, cy = change[:5]
        K = camera.K + np.array([[fx, skew, cx], [0.0, fy, cy], [0.0, 0.0, 0.0]])
        R = Rotation.from_rotvec(change[5:8]).as_matrix() @ camera.R
        moved = Camera(K, R, camera.t_mm + change[8:], camera.width, camera.height)
        columns.append((moved.project(points) - camera.project(points)) / step)
    return np.stack(columns, axis=-1)


def _pairs(points_a: ArrayLike, points_b: ArrayLike) -> tuple[Array, Array]:
    a, b = np.asarray(points_a, dtype=float), np.asarray(points_b, dtype=float)
    if a.shape != b.shape or a.ndim != 2 or a.shape[1] != 2:
        raise ValueError(f"expected two lists of as many points (n, 2) px, got {a.shape} and {b.shape}")
    return a, b
