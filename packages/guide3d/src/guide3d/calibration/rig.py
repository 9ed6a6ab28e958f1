"""Calibration of a rig of detectors from the beads of a cube in one or several poses, all refined together.

World: the cube's frame in the first pose, millimetres. The detectors stay where they are, the cube moves. A detector
has all five intrinsics and, where the beads ask for it, a swirl: the part of an image intensifier's distortion that
follows the magnetic field and need not be that of the sheet's image any more.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from guide3d.calibration.pinhole_fit import (
    changed_intrinsics,
    huber,
    projection_jacobian,
    ransac_camera,
    refine_camera,
    turn_jacobian,
    turned,
)
from guide3d.geometry.camera import Camera
from guide3d.geometry.distortion import swirl_pattern

logger = logging.getLogger(__name__)

_LEAST_BEADS = 12
_SWIRL_SIGNIFICANT = 12.0  # fall of the sum of squares in units of the variance; chance gives as much once in 2,000
_OUTLIER_SD = 3.5
_OUTLIER_PX = 1.0  # nothing closer is called an outlier
_RIGID_PX = 3.0  # RMS that a pose may leave in a rigid rig


@dataclass(frozen=True, eq=False)
class Sighting:
    """Beads seen by one detector in one pose.

    numbers: (n,) bead numbers, from 0
    pixels: (n, 2) undistorted px
    """

    pose: str
    detector: str
    numbers: np.ndarray
    pixels: np.ndarray


@dataclass(frozen=True, eq=False)
class RigCalibration:
    """Detectors with their uncertainty, and what the fit left.

    cameras: by detector, with covariance
    swirl_px: by detector, shift at the border of the image; zero where the beads did not ask for it
    poses: by pose, (R (3, 3), t (3,) mm) from the cube's frame to the world
    residuals_px: by (pose, detector), (n, 2) projection minus measurement
    used: by (pose, detector), (n,) bool, False for outliers
    alone_px: by (pose, detector), (n, 2) residuals of a camera fitted to that image alone
    noise_px: standard deviation of a pixel coordinate
    """

    cameras: dict[str, Camera]
    swirl_px: dict[str, float]
    poses: dict[str, tuple[np.ndarray, np.ndarray]]
    residuals_px: dict[tuple[str, str], np.ndarray]
    used: dict[tuple[str, str], np.ndarray]
    alone_px: dict[tuple[str, str], np.ndarray]
    noise_px: float
    left_out: dict[str, str] = field(default_factory=dict)


def calibrate_rig(
    points_mm: np.ndarray,
    sightings: Sequence[Sighting],
    sizes: Mapping[str, tuple[int, int]],
    swirl: str = "auto",
) -> RigCalibration:
    """Calibrate all detectors of a rig at once: cameras with covariances, and all residuals.

    Args:
        points_mm: (m, 3) beads in the cube's frame, mm.
        sightings: One an image; the first's pose gives the world.
        sizes: (width, height) of every detector's images, px.
        swirl: "auto": a detector gets a swirl where it is significant; "never"; "always".

    Raises:
        ValueError: No sightings, an image with fewer than twelve beads, or with labels that no camera agrees with.
    """
    if swirl not in ("auto", "never", "always"):
        raise ValueError(f'expected swirl "auto", "never" or "always", found {swirl!r}')
    if not sightings:
        raise ValueError("expected sightings of the cube, found none")
    points_mm = np.asarray(points_mm, float)
    starts: list[Camera] = []
    used: list[np.ndarray] = []
    alone: dict[tuple[str, str], np.ndarray] = {}
    for seen in sightings:
        if len(seen.numbers) < _LEAST_BEADS:
            raise ValueError(
                f"{seen.pose}, detector {seen.detector}: expected {_LEAST_BEADS} beads or more, "
                f"found {len(seen.numbers)}"
            )
        width, height = sizes[seen.detector]
        try:
            camera, agree = ransac_camera(points_mm[seen.numbers], seen.pixels, width, height, 4.0)
        except ValueError as error:
            raise ValueError(f"{seen.pose}, detector {seen.detector}: {error}") from None
        own = points_mm[seen.numbers]
        starts.append(refine_camera(camera, own[agree], seen.pixels[agree], robust_px=2.0))
        used.append(agree)
    bundle = _Bundle(points_mm, sightings, starts, sizes)
    inliers, left_out = bundle.rigid(used)
    bundle = _Bundle(points_mm, [sightings[k] for k in inliers], [starts[k] for k in inliers], sizes)
    used = [used[k] for k in inliers]
    swirled = dict.fromkeys(bundle.detectors, swirl == "always")
    for attempt in range(4):
        bundle.solve(used, swirled)
        residuals = bundle.residuals()
        pooled = np.concatenate([r[u] for r, u in zip(residuals, used, strict=True)])
        limit = max(_OUTLIER_SD * 1.48 * float(np.median(np.abs(pooled))), _OUTLIER_PX)
        again = [np.linalg.norm(r, axis=1) < limit for r in residuals]
        changed = any((a != u).any() for a, u in zip(again, used, strict=True))
        used = [a if a.sum() >= _LEAST_BEADS else u for a, u in zip(again, used, strict=True)]
        if swirl == "auto" and attempt < 3:
            significance = {d: bundle.swirl_gain(used, swirled, d) > _SWIRL_SIGNIFICANT for d in bundle.detectors}
            changed |= significance != swirled
            swirled = significance
        if not changed:
            break
    bundle.solve(used, swirled)
    for seen, agree in zip(bundle.sightings, used, strict=True):
        single = _Bundle(points_mm, [seen], [bundle.starts[seen.pose, seen.detector]], sizes)
        single.solve([agree], {seen.detector: swirled[seen.detector]})
        alone[seen.pose, seen.detector] = single.residuals()[0]
    return bundle.calibration(used, swirled, alone, left_out)


class _Bundle:
    """All parameters of a rig: twelve a detector (intrinsics, swirl, rotation, translation), six a further pose."""

    def __init__(
        self,
        points_mm: np.ndarray,
        sightings: Sequence[Sighting],
        starts: Sequence[Camera],
        sizes: Mapping[str, tuple[int, int]],
    ) -> None:
        self.points_mm, self.sightings, self.sizes = points_mm, list(sightings), sizes
        self.detectors = list(dict.fromkeys(s.detector for s in sightings))
        self.pose_names = list(dict.fromkeys(s.pose for s in sightings))
        own = {(s.pose, s.detector): camera for s, camera in zip(sightings, starts, strict=True)}
        world = self.pose_names[0]
        self.cameras: dict[str, Camera] = {d: own[world, d] for d in self.detectors if (world, d) in own}
        self.poses: dict[str, tuple[np.ndarray, np.ndarray]] = {world: (np.eye(3), np.zeros(3))}
        self.swirl = dict.fromkeys(self.detectors, 0.0)
        # spread from the first pose over images until every detector and pose has a place
        waiting = dict(own)
        while len(self.cameras) < len(self.detectors) or len(self.poses) < len(self.pose_names):
            before = len(self.cameras) + len(self.poses)
            for (pose, detector), camera in waiting.items():
                if pose in self.poses and detector not in self.cameras:
                    Q, s = self.poses[pose]
                    R = camera.R @ Q.T
                    self.cameras[detector] = _placed(camera, R, camera.t_mm - R @ s)
                elif pose not in self.poses and detector in self.cameras:
                    rig = self.cameras[detector]
                    self.poses[pose] = rig.R.T @ camera.R, rig.R.T @ (camera.t_mm - rig.t_mm)
            if len(self.cameras) + len(self.poses) == before:
                lost = [name for name in self.pose_names if name not in self.poses]
                raise ValueError(f"expected poses that share a detector with the others, found {', '.join(lost)} alone")
        self.starts = own  # by (pose, detector), each in its own cube's frame

    def rigid(self, used: list[np.ndarray]) -> tuple[list[int], dict[str, str]]:
        """Which sightings (indices) belong to one rigid rig, and why poses were left out."""
        left_out: dict[str, str] = {}
        if len(self.pose_names) < 2 or len(self.detectors) < 2:
            return list(range(len(self.sightings))), left_out
        self.solve(used, dict.fromkeys(self.detectors, False), robust_px=2.0)
        worst = dict.fromkeys(self.pose_names, 0.0)
        for seen, residual, agree in zip(self.sightings, self.residuals(), used, strict=True):
            worst[seen.pose] = max(worst[seen.pose], float(np.sqrt((residual[agree] ** 2).sum(axis=1).mean())))
        for name, rms in worst.items():
            if rms > _RIGID_PX and name != self.pose_names[0]:
                left_out[name] = f"leaves {rms:.1f} px RMS in a rig that stands still: its detectors stood elsewhere"
        numbers = [k for k, seen in enumerate(self.sightings) if seen.pose not in left_out]
        return numbers, left_out

    def _assembled(
        self, used: list[np.ndarray], robust_px: float | None
    ) -> tuple[float, np.ndarray, np.ndarray, list[np.ndarray]]:
        n = 12 * len(self.detectors) + 6 * (len(self.pose_names) - 1)
        normal, gradient, cost, residuals = np.zeros((n, n)), np.zeros(n), 0.0, []
        for seen, agree in zip(self.sightings, used, strict=True):
            d, p = self.detectors.index(seen.detector), self.pose_names.index(seen.pose)
            camera, (Q, s) = self.cameras[seen.detector], self.poses[seen.pose]
            moved = self.points_mm[seen.numbers] @ Q.T
            pixels, own = projection_jacobian(camera.K, camera.R, camera.t_mm, moved + s)
            pattern = swirl_pattern(seen.pixels, *self.sizes[seen.detector])
            residual = pixels - seen.pixels - self.swirl[seen.detector] * pattern
            J = np.zeros((len(residual), 2, n))
            J[:, :, 12 * d : 12 * d + 5] = own[:, :, :5]
            J[:, :, 12 * d + 5] = -pattern
            J[:, :, 12 * d + 6 : 12 * d + 12] = own[:, :, 5:]
            if p:
                at = 12 * len(self.detectors) + 6 * (p - 1)
                place = own[:, :, 8:] @ camera.R
                J[:, :, at : at + 3], J[:, :, at + 3 : at + 6] = place @ turn_jacobian(moved), place
            weight, costs = huber(np.linalg.norm(residual, axis=1), robust_px)
            cost += float(costs[agree].sum())
            weight = agree * weight
            normal += np.einsum("n,nij,nik->jk", weight, J, J)
            gradient += np.einsum("n,nij,ni->j", weight, J, residual)
            residuals.append(residual)
        return cost, gradient, normal, residuals

    def _free(self, swirled: Mapping[str, bool]) -> np.ndarray:
        free = np.ones(12 * len(self.detectors) + 6 * (len(self.pose_names) - 1), bool)
        for d, detector in enumerate(self.detectors):
            free[12 * d + 5] = swirled[detector]
        return np.flatnonzero(free)

    def _state(self) -> tuple[dict, dict, dict]:
        return dict(self.cameras), dict(self.poses), dict(self.swirl)

    def _step(self, step: np.ndarray) -> bool:
        """Take a step; False where it leads nowhere sensible (and nothing is changed then)."""
        cameras, poses, swirl = self._state()
        for d, detector in enumerate(self.detectors):
            own, camera = step[12 * d : 12 * d + 12], cameras[detector]
            K = changed_intrinsics(camera.K, own[:5])
            if min(K[0, 0], K[1, 1]) <= 0:
                return False
            cameras[detector] = _placed(camera, turned(camera.R, own[6:9]), camera.t_mm + own[9:12], K)
            swirl[detector] += float(own[5])
        for p, name in enumerate(self.pose_names[1:]):
            own = step[12 * len(self.detectors) + 6 * p :][:6]
            Q, s = poses[name]
            poses[name] = Rotation.from_rotvec(own[:3]).as_matrix() @ Q, s + own[3:]
        self.cameras, self.poses, self.swirl = cameras, poses, swirl
        return True

    def solve(self, used: list[np.ndarray], swirled: Mapping[str, bool], robust_px: float | None = None) -> None:
        """Levenberg-Marquardt over all free parameters."""
        free = self._free(swirled)
        for detector, with_swirl in swirled.items():
            if not with_swirl:
                self.swirl[detector] = 0.0
        cost, gradient, normal, _ = self._assembled(used, robust_px)
        damping = 1e-4
        for _ in range(60):
            N = normal[np.ix_(free, free)]
            step = np.zeros(len(gradient))
            step[free] = -np.linalg.solve(N + damping * np.diag(np.diag(N)) + 1e-12 * np.eye(len(free)), gradient[free])
            before = self._state()
            taken = self._step(step)
            trial = self._assembled(used, robust_px) if taken else None
            if trial is None or not trial[0] < cost:
                self.cameras, self.poses, self.swirl = before
                damping *= 10
                if damping > 1e8:
                    break
                continue
            settled = cost - trial[0] < 1e-11 * cost
            cost, gradient, normal, _ = trial
            damping = max(damping / 10, 1e-12)
            if settled:
                break

    def residuals(self) -> list[np.ndarray]:
        """Projection minus measurement (n, 2) of every sighting."""
        return self._assembled([np.ones(len(s.numbers), bool) for s in self.sightings], None)[3]

    def _variance(self, used: list[np.ndarray], free: np.ndarray) -> float:
        cost = self._assembled(used, None)[0]
        return cost / max(2 * sum(int(u.sum()) for u in used) - len(free), 1)

    def swirl_gain(self, used: list[np.ndarray], swirled: Mapping[str, bool], detector: str) -> float:
        """By how many variances the sum of squares falls when this detector may swirl."""
        before = self._state()
        costs = []
        for with_swirl in (False, True):
            choice = {**swirled, detector: with_swirl}
            self.solve(used, choice)
            costs.append(self._assembled(used, None)[0])
            variance = self._variance(used, self._free(choice))
        self.cameras, self.poses, self.swirl = before
        return (costs[0] - costs[1]) / max(variance, 1e-12)

    def calibration(
        self,
        used: list[np.ndarray],
        swirled: Mapping[str, bool],
        alone: dict[tuple[str, str], np.ndarray],
        left_out: dict[str, str],
    ) -> RigCalibration:
        """The result, with covariances from the residuals' own spread."""
        free = self._free(swirled)
        _, _, normal, residuals = self._assembled(used, None)
        variance = self._variance(used, free)
        whole = np.zeros_like(normal)
        scale = 1 / np.sqrt(np.diag(normal)[free])  # units from pixels to radians: balance before inverting
        N = normal[np.ix_(free, free)] * scale[:, None] * scale
        whole[np.ix_(free, free)] = variance * np.linalg.inv(N) * scale[:, None] * scale
        cameras = {}
        for d, detector in enumerate(self.detectors):
            rows = 12 * d + np.array([0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11])
            camera = self.cameras[detector]
            cameras[detector] = Camera(
                camera.K, camera.R, camera.t_mm, *self.sizes[detector], detector, whole[np.ix_(rows, rows)]
            )
        keys = [(s.pose, s.detector) for s in self.sightings]
        bead_masks, residual = dict(zip(keys, used, strict=True)), dict(zip(keys, residuals, strict=True))
        return RigCalibration(
            cameras, dict(self.swirl), dict(self.poses), residual, bead_masks, alone, float(np.sqrt(variance)), left_out
        )


def _placed(camera: Camera, R: np.ndarray, t_mm: np.ndarray, K: np.ndarray | None = None) -> Camera:
    return Camera(camera.K if K is None else K, R, t_mm, camera.width, camera.height, camera.name)
