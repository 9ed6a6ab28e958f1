"""One camera from points in space and their pixels: normalised linear transformation, RANSAC, non-linear refinement.

The five intrinsic parameters are all free, skew included: an image intensifier's axes are neither square nor alike.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from guide3d.geometry.camera import Camera
from guide3d.setting_kinds import Positive, settings


@settings
class IntrinsicPrior:
    """Soft knowledge of a detector that keeps a fit to few points sane: values and standard deviations, px.

    focal_px: of fx and fy
    focal_sd: relative
    aspect_sd: of fx / fy from one
    skew_sd: px
    centre_sd: of the principal point from the image's middle, px
    """

    focal_px: Positive = 4800.0
    focal_sd: Positive = 0.3
    aspect_sd: Positive = 0.02
    skew_sd: Positive = 20.0
    centre_sd: Positive = 200.0

    def rows(self, K: np.ndarray, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (5,) in standard deviations, their slopes (5, 11) by the parameters of `projection_jacobian`."""
        residual = np.array(
            [
                np.log(K[0, 0] * K[1, 1] / self.focal_px**2) / 2 / self.focal_sd,
                np.log(K[0, 0] / K[1, 1]) / self.aspect_sd,
                K[0, 1] / self.skew_sd,
                (K[0, 2] - (width - 1) / 2) / self.centre_sd,
                (K[1, 2] - (height - 1) / 2) / self.centre_sd,
            ]
        )
        J = np.zeros((5, 11))
        J[0, :2] = 1 / K[0, 0] / 2 / self.focal_sd, 1 / K[1, 1] / 2 / self.focal_sd
        J[1, :2] = 1 / K[0, 0] / self.aspect_sd, -1 / K[1, 1] / self.aspect_sd
        J[2, 2], J[3, 3], J[4, 4] = 1 / self.skew_sd, 1 / self.centre_sd, 1 / self.centre_sd
        return residual, J


def turned(R: np.ndarray, rotation_vector: np.ndarray) -> np.ndarray:
    """The rotation R after a further small one in its target frame (the camera's): (3, 3)."""
    return Rotation.from_rotvec(rotation_vector).as_matrix() @ R


def turn_jacobian(points: np.ndarray) -> np.ndarray:
    """How points (n, 3) move with a small rotation vector w: d(w x p)/dw = -[p]x, (n, 3, 3)."""
    J = np.zeros((len(points), 3, 3))
    J[:, [1, 2, 0], [2, 0, 1]] = points
    J[:, [2, 0, 1], [1, 2, 0]] = -points
    return J


def changed_intrinsics(K: np.ndarray, step: np.ndarray) -> np.ndarray:
    """K (3, 3) with (fx, fy, skew, cx, cy) changed by a step (5,), px."""
    changed = K.copy()
    changed[[0, 1, 0, 0, 1], [0, 1, 1, 2, 2]] += step
    return changed


def huber(size: np.ndarray, limit: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Weights (n,) and costs (n,) of residuals of sizes (n,): quadratic, linear beyond a limit if there is one."""
    if limit is None:
        return np.ones_like(size), size**2
    weight = np.minimum(1.0, limit / np.maximum(size, 1e-12))
    return weight, np.where(size > limit, 2 * limit * size - limit**2, size**2)


def projection_jacobian(
    K: np.ndarray, R: np.ndarray, t_mm: np.ndarray, points_mm: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of points, and how they move with the eleven parameters of a camera.

    Args:
        K: (3, 3) px.
        R: (3, 3) world to camera.
        t_mm: (3,) mm.
        points_mm: (n, 3) world, mm.

    Returns:
        (n, 2) px and (n, 2, 11): by fx, fy, skew, cx, cy (px), a small rotation in the camera frame (rad), t (mm).
    """
    turned_mm = points_mm @ R.T
    X, Y, Z = (turned_mm + t_mm).T
    x, y = X / Z, Y / Z
    fx, skew, cx, fy, cy = K[0, 0], K[0, 1], K[0, 2], K[1, 1], K[1, 2]
    pixels = np.column_stack([fx * x + skew * y + cx, fy * y + cy])
    J = np.zeros((len(points_mm), 2, 11))
    J[:, 0, 0], J[:, 1, 1], J[:, 0, 2], J[:, 0, 3], J[:, 1, 4] = x, y, y, 1.0, 1.0
    place = np.zeros((len(points_mm), 2, 3))  # by the point in the camera frame
    place[:, 0, 0], place[:, 0, 1], place[:, 0, 2] = fx / Z, skew / Z, -(fx * x + skew * y) / Z
    place[:, 1, 1], place[:, 1, 2] = fy / Z, -fy * y / Z
    J[:, :, 5:8] = place @ turn_jacobian(turned_mm)
    J[:, :, 8:] = place
    return pixels, J


def direct_linear_transformation(points_mm: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """The projection matrix (3, 4), of unit norm, of at least six points, by normalised linear least squares.

    Args:
        points_mm: (n, 3), not all in one plane.
        pixels: (n, 2) undistorted.

    Raises:
        ValueError: Fewer than six pairs.

    Source: R. Hartley and A. Zisserman, "Multiple View Geometry", 2nd edition, algorithm 7.1, linear part.
    """
    points_mm, pixels = np.asarray(points_mm, float), np.asarray(pixels, float)
    if len(points_mm) < 6 or len(points_mm) != len(pixels):
        raise ValueError(f"expected six points or more and as many pixels, found {len(points_mm)} and {len(pixels)}")
    U, X = _normaliser(points_mm), np.column_stack([points_mm, np.ones(len(points_mm))])
    T, x = _normaliser(pixels), np.column_stack([pixels, np.ones(len(pixels))])
    X, x = X @ U.T, x @ T.T
    A = np.zeros((2 * len(X), 12))
    A[0::2, 0:4], A[0::2, 8:] = X, -x[:, :1] * X
    A[1::2, 4:8], A[1::2, 8:] = X, -x[:, 1:2] * X
    P = np.linalg.svd(A)[2][-1].reshape(3, 4)
    P = np.linalg.solve(T, P) @ U
    return P / np.linalg.norm(P)


def _normaliser(points: np.ndarray) -> np.ndarray:
    """The similarity that brings points (n, d) to mean zero and RMS distance sqrt(d), homogeneous (d + 1, d + 1)."""
    d = points.shape[1]
    scale = np.sqrt(d) / max(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()), 1e-12)
    T = np.diag([scale] * d + [1.0])
    T[:d, d] = -scale * points.mean(axis=0)
    return T


def ransac_camera(
    points_mm: np.ndarray,
    pixels: np.ndarray,
    width: int,
    height: int,
    tolerance_px: float = 3.0,
    rounds: int = 300,
    seed: int = 0,
) -> tuple[Camera, np.ndarray]:
    """A camera and the pairs that agree with it, when some pairs are wrong.

    Args:
        points_mm: (n, 3) world, mm.
        pixels: (n, 2) undistorted px.
        width, height: Of the image, px.

    Returns:
        The camera, linear from all agreeing pairs, and which pairs agree (n,) bool.

    Raises:
        ValueError: Fewer than six pairs, or no camera that as many as eight agree with.
    """
    points_mm, pixels = np.asarray(points_mm, float), np.asarray(pixels, float)
    rng = np.random.default_rng(seed)
    n = len(points_mm)
    # more than the six of a minimal sample: linear cameras of six noisy points agree with few pairs
    size = min(max(6, n // 3), 10)
    best = np.zeros(n, bool)
    samples = [np.arange(n)] + [rng.choice(n, size, replace=False) for _ in range(rounds if n > size else 0)]
    for sample in samples:
        P = direct_linear_transformation(points_mm[sample], pixels[sample])
        agree = _off(P, points_mm, pixels) < tolerance_px
        for _ in range(3):
            if agree.sum() < 8:
                break
            agree = (
                _off(direct_linear_transformation(points_mm[agree], pixels[agree]), points_mm, pixels) < tolerance_px
            )
        if agree.sum() > best.sum():
            best = agree
        if best.sum() >= 0.95 * n:
            break
    if best.sum() < 8:
        raise ValueError(
            f"expected a camera that most of {n} points agree with, found one that {best.sum()} agree with"
        )
    P = direct_linear_transformation(points_mm[best], pixels[best])
    P = P * np.sign(np.median(points_mm @ P[2, :3] + P[2, 3]))  # depths are positive
    return Camera.from_P(P, width, height), best


def _off(P: np.ndarray, points_mm: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    seen = points_mm @ P[:, :3].T + P[:, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.nan_to_num(np.linalg.norm(seen[:, :2] / seen[:, 2:] - pixels, axis=1), nan=np.inf)


def refine_camera(
    camera: Camera,
    points_mm: np.ndarray,
    pixels: np.ndarray,
    prior: IntrinsicPrior | None = None,
    noise_px: float = 1.0,
    robust_px: float | None = None,
    rounds: int = 30,
) -> Camera:
    """The camera with the least squared reprojection error, by Levenberg-Marquardt, without a covariance.

    Args:
        points_mm: (n, 3) world, mm.
        pixels: (n, 2) undistorted px.
        prior: On the intrinsics, weighed against `noise_px`; None needs six points or more in general position.
        noise_px: Standard deviation of a pixel coordinate; it matters beside a prior only.
        robust_px: Pixels farther off than this pull with constant force (Huber); None for plain squares.
        rounds: At most so many steps.
    """
    points_mm, pixels = np.asarray(points_mm, float), np.asarray(pixels, float)
    K, R, t = camera.K.copy(), camera.R, camera.t_mm

    def assembled(K: np.ndarray, R: np.ndarray, t: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        seen, J = projection_jacobian(K, R, t, points_mm)
        off = (seen - pixels) / noise_px
        size = np.linalg.norm(off, axis=1)
        weight, costs = huber(size, None if robust_px is None else robust_px / noise_px)
        cost = float(costs.sum())
        J = J / noise_px
        gradient = np.einsum("n,nij,ni->j", weight, J, off)
        normal = np.einsum("n,nij,nik->jk", weight, J, J)
        if prior is not None:
            residual, rows = prior.rows(K, camera.width, camera.height)
            cost += float((residual**2).sum())
            gradient, normal = gradient + rows.T @ residual, normal + rows.T @ rows
        return cost, gradient, normal

    cost, gradient, normal = assembled(K, R, t)
    damping = 1e-4
    for _ in range(rounds):
        step = -np.linalg.solve(normal + damping * np.diag(np.diag(normal)) + 1e-12 * np.eye(11), gradient)
        K2 = changed_intrinsics(K, step[:5])
        R2, t2 = turned(R, step[5:8]), t + step[8:]
        if min(K2[0, 0], K2[1, 1]) <= 0 or (points_mm @ R2[2] + t2[2] <= 0).any():
            damping *= 10
            continue
        trial = assembled(K2, R2, t2)
        if trial[0] > cost:
            damping *= 10
            if damping > 1e8:
                break
            continue
        settled = cost - trial[0] < 1e-10 * cost
        K, R, t = K2, R2, t2
        cost, gradient, normal = trial
        damping = max(damping / 10, 1e-12)
        if settled:
            break
    return Camera(K, R, t, camera.width, camera.height, camera.name)
