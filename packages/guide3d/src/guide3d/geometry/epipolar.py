"""Two-view geometry: the fundamental matrix, epilines, and the epipolar angle that both views share.

All planes through both X-ray sources form a pencil. The angle of the plane that a pixel lies in is a number that its
counterpart in the other view has as well, so that a wire's two images become two signals of one variable.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from guide3d.geometry.camera import Camera
from guide3d.geometry.polyline import Array


def cross_matrix(v: ArrayLike) -> Array:
    """Returns the (3, 3) matrix [v]x with [v]x w = v x w."""
    x, y, z = np.asarray(v, dtype=float)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def fundamental_matrix(camera_a: Camera, camera_b: Camera) -> Array:
    """Returns the (3, 3) fundamental matrix F with x_b^T F x_a = 0 for two images of one point, of norm 1.

    Returns:
        F = [e_b]x P_b P_a^+, with e_b = P_b C_a the image of the first source in the second view.

    Raises:
        ValueError: both cameras have one source.

    Source:
        Hartley and Zisserman, Multiple View Geometry (2004), eq. 9.1.
    """
    _baseline(camera_a, camera_b)
    e_b = camera_b.P @ np.append(camera_a.centre_mm, 1.0)
    # a normalised world keeps the pseudo-inverse accurate: millimetres against a homogeneous 1 span six decades
    scale = np.diag([1e3, 1e3, 1e3, 1.0])
    F = cross_matrix(e_b) @ (camera_b.P @ scale) @ np.linalg.pinv(camera_a.P @ scale)
    return np.asarray(F / np.linalg.norm(F))


def epilines(F: ArrayLike, points: ArrayLike) -> Array:
    """Returns the epilines in the second view of points of the first.

    Args:
        F: (3, 3) fundamental matrix from the first view to the second (its transpose the other way).
        points: (n, 2) px.

    Returns:
        (n, 3) lines (l, m, n) with l x + m y + n = 0 and l^2 + m^2 = 1, so that this is a signed distance in px.
    """
    points = np.asarray(points, dtype=float)
    lines = points @ np.asarray(F)[:, :2].T + np.asarray(F)[:, 2]
    return np.asarray(lines / np.linalg.norm(lines[:, :2], axis=1, keepdims=True))


@dataclass(frozen=True)
class EpipolarCoordinate:
    """Where points of one view lie in the pencil of epipolar planes.

    angle: (n,) rad, of the epipolar plane
    gradient: (n, 2) rad/px, of the angle over the image; epilines run across it
    rays: (n, 3) unit directions from the source in the world
    """

    angle: Array
    gradient: Array
    rays: Array

    @property
    def slope_squared(self) -> Array:
        """(n,) rad^2/px^2."""
        return np.asarray((self.gradient**2).sum(axis=1))


class EpipolarGeometry:
    """The pencil of epipolar planes of two cameras.

    Raises:
        ValueError: both cameras have one source.
    """

    def __init__(self, camera_a: Camera, camera_b: Camera) -> None:
        self.cameras = (camera_a, camera_b)
        self.baseline_mm = _baseline(camera_a, camera_b)
        axis = self.baseline_mm / np.linalg.norm(self.baseline_mm)
        forward = camera_a.R[2] + camera_b.R[2]
        forward = forward - axis * (axis @ forward)
        if np.linalg.norm(forward) < 1e-6:  # the views look along the baseline: any direction across it will do
            forward = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
        self._u = forward / np.linalg.norm(forward)
        self._v = np.cross(axis, self._u)

    def coordinate(self, view: int, points: ArrayLike) -> EpipolarCoordinate:
        """Returns where (n, 2) px of view 0 (A) or 1 (B) lie in the pencil."""
        camera = self.cameras[view]
        points = np.asarray(points, dtype=float)
        M = camera.R.T @ np.linalg.inv(camera.K)
        rays = points @ M[:, :2].T + M[:, 2]
        p, q = rays @ self._u, rays @ self._v
        gradient = (p[:, None] * (self._v @ M[:, :2]) - q[:, None] * (self._u @ M[:, :2])) / (p * p + q * q)[:, None]
        return EpipolarCoordinate(np.arctan2(q, p), gradient, rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def signed_distance(self, points_a: ArrayLike, points_b: ArrayLike) -> Array:
        """Returns the signed epipolar distance (n,) px of pairs (n, 2) px: how far both together are off one plane.

        It is the Sampson distance: the smallest move of the pair, sqrt(da^2 + db^2), that puts both on one plane.

        Source:
            Hartley and Zisserman (2004), eq. 11.9, in the pencil's angle, where the constraint is linear.
        """
        a, b = self.coordinate(0, points_a), self.coordinate(1, points_b)
        return np.asarray((a.angle - b.angle) / np.sqrt(a.slope_squared + b.slope_squared))

    def tangent_share(self, view: int, points: ArrayLike) -> float:
        """Returns the share of a (n, 2) polyline's length that runs within 10 degrees of its epilines."""
        points = np.asarray(points, dtype=float)
        steps = np.diff(points, axis=0)
        gradient = self.coordinate(view, 0.5 * (points[1:] + points[:-1])).gradient
        length = np.linalg.norm(steps, axis=1)
        across = np.abs((steps * gradient).sum(axis=1)) / np.linalg.norm(gradient, axis=1)
        return float(length[across <= np.sin(np.radians(10.0)) * length].sum() / length.sum())


def _baseline(camera_a: Camera, camera_b: Camera) -> Array:
    baseline = camera_b.centre_mm - camera_a.centre_mm
    if np.linalg.norm(baseline) < 1e-3:
        raise ValueError(
            f"cameras {camera_a.name or 'A'} and {camera_b.name or 'B'} have one and the same source at "
            f"{np.round(camera_a.centre_mm, 1).tolist()} mm; two views from different places are needed"
        )
    return np.asarray(baseline)
