"""View in space: what two cameras of known geometry show together, measured from the wire's tip.

Places of both curves that belong together are found along the epilines (`guide3d.reconstruction.matching`) and
triangulated. The frame is the wire's own: z out of the tip, y to the side towards which the tip is bent against the
shaft behind it. So what lies ahead is given as a turn of the wire would meet it.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from guide3d.geometry.camera import Camera
from guide3d.geometry.epipolar import EpipolarGeometry
from guide3d.geometry.polyline import arc_length, at_length, resample
from guide3d.geometry.triangulation import triangulate_linear
from guide3d.reconstruction.matching import MatchingSettings, match_curves
from splineformer.navigation.perception import WireReading
from splineformer.navigation.space_map import CELL_MM, SpaceMap

Array = NDArray[np.float64]

WAY_MM = np.array([3.0, 6.0, 10.0, 16.0, 24.0, 36.0, 50.0])  # ahead
WIRE_MM = np.array([4.0, 8.0, 12.0, 20.0, 30.0, 45.0])  # behind the tip
HEADING_MM, SHAFT_MM = 6.0, (12.0, 26.0)  # the tip's direction; the shaft's, between these distances
RAY_MM, RAY_SAMPLES = 30.0, 10
RAYS = np.array(
    [(0, 0, 1), *((x, y, z) for z in (1, 0) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)))], float
)  # fmt: skip
RAYS /= np.linalg.norm(RAYS, axis=1, keepdims=True)
SIZE = 3 * len(WAY_MM) + 3 * len(WIRE_MM) + len(RAYS) + 31

_SEEN = 0.3  # of the image's side: so much of the curves is matched
_FULL_PX = 1024  # side of the images in whose px the matching's defaults are meant
_WINDOW = 7  # points that noise is smoothed over
_LEAST = 8  # points of a wire in space
_REMAINING_MM, _NEAR_MM, _MOTION_MM, _PLACE_MM = 200.0, 20.0, 4.0, 100.0  # what counts as 1
_LIMIT = 5.0
_AGO = (1, 2)


class SpaceView:
    """What two cameras show together over an episode.

    Args:
        space: the map of the vessels, with the cameras.
    """

    def __init__(self, space: SpaceMap) -> None:
        self.space = space
        cameras = space.hull.cameras
        self._geometry = EpipolarGeometry(*cameras)
        scale = cameras[0].width / _FULL_PX
        plain = MatchingSettings()
        self._settings = MatchingSettings(
            sample_px=4.0 * scale, match_px=plain.match_px * scale, crossing_px=2 * plain.crossing_px * scale,
            noise_px=2 * plain.noise_px * scale, length_per_mm=plain.length_per_mm,
            uneven_per_px=plain.uneven_per_px, tip_reach_px=plain.tip_reach_px * scale,
            measured_px=2 * plain.measured_px * scale,
        )  # fmt: skip
        self._tips: list[Array] = []

    def wire(self, readings: Sequence[WireReading]) -> tuple[Array, float]:
        """The wire behind its tip, in space.

        Returns:
            (n, 3) mm, world, tip first; the share of it that is measured, 0 where the curves do not match at all.
        """
        cameras, step = self.space.hull.cameras, self._settings.sample_px
        curves = [_beginning(reading, camera, step) for reading, camera in zip(readings, cameras, strict=True)]
        match = match_curves(self._geometry, curves[0], curves[1], self._settings)
        a, b, share = match.points_a, match.points_b, float(match.measured.mean()) if len(match.measured) else 0.0
        if len(a) < _LEAST or not share:  # taken as they come along both curves
            count = max(_LEAST, min(len(curve) for curve in curves))
            a, b = (resample(curve, count=count) for curve in curves)
            share = 0.0
        points = triangulate_linear(*cameras, a, b)
        smooth = _smoothing(len(points)) @ points
        step_mm = np.linalg.norm(np.diff(smooth, axis=0), axis=1)
        return smooth[np.concatenate(([True], step_mm > 1e-3))], share

    def look(self, readings: Sequence[WireReading]) -> NDArray[np.float32]:
        """What both readings show together; to be called once a decision.

        Returns:
            In the wire's frame: the way ahead over its distances (21), the wire behind the tip over its distances (18),
            distances to the wall along `RAYS` over 30 mm (9), the direction to the target (3), the tip's motion since
            one and two decisions ago (6). In the world's: the tip's direction and bend (6), its place (3), the way's
            directions 10 and 24 mm ahead (6). The hyperbolic tangent of the distance to the target over 20 mm, the
            remaining way over 200 mm and its tangent over 20 mm, how much the tip is bent, how long the wire is, how
            much of it is measured, the distance between both tips' rays (7). Shape (SIZE,).
        """
        points, share = self.wire(readings)
        arc = arc_length(points)
        tip = points[0]
        heading = _unit(tip - at_length(points, min(HEADING_MM, arc[-1])))
        near, far = (at_length(points, min(mm, arc[-1] * part)) for mm, part in zip(SHAFT_MM, (0.4, 1.0), strict=True))
        shaft = _unit(near - far)
        bend = heading - shaft * float(heading @ shaft)
        across = bend - heading * float(bend @ heading)
        if np.linalg.norm(across) < 1e-6:  # a straight wire: any side will do
            across = np.eye(3)[np.abs(heading).argmin()]
            across = across - heading * float(across @ heading)
        y = _unit(across)
        axes = np.stack([np.cross(y, heading), y, heading], axis=1)
        way = self.space.way(tip, WAY_MM[-1])
        along = arc_length(way)
        ahead = at_length(way, np.minimum(WAY_MM, along[-1])) - tip
        behind = at_length(points, np.minimum(WIRE_MM, arc[-1])) - tip
        goal = self.space.target - tip
        away = max(float(np.linalg.norm(goal)), 1e-3)
        remaining = self.space.remaining(tip)
        self._tips = [*(self._tips or [tip] * max(_AGO)), tip][-max(_AGO) - 1 :]
        moved = [(tip - self._tips[-1 - ago]) @ axes / _MOTION_MM for ago in _AGO]
        reach = np.arange(1, RAY_SAMPLES + 1) * RAY_MM / RAY_SAMPLES
        seen = self.space.sample(tip + (RAYS @ axes.T)[:, None] * reach[:, None])
        open_ = np.minimum.accumulate(seen > 0.5, axis=1).mean(axis=1)
        middle = self.space.hull.origin_mm + 0.5 * CELL_MM * np.array(self.space.hull.lumen.shape)
        parts = [
            ahead @ axes / WAY_MM[:, None], behind @ axes / WIRE_MM[:, None], open_, goal @ axes / away, *moved,
            heading, bend, (tip - middle) / _PLACE_MM, ahead[[2, 4]] / WAY_MM[[2, 4], None],
            (np.tanh(away / _NEAR_MM), remaining / _REMAINING_MM, np.tanh(remaining / _NEAR_MM)),
            (np.linalg.norm(bend), arc[-1] / WIRE_MM[-1], share, self._apart(readings)),
        ]  # fmt: skip
        return np.clip(np.concatenate([np.ravel(part) for part in parts]), -_LIMIT, _LIMIT).astype(np.float32)

    def _apart(self, readings: Sequence[WireReading]) -> float:
        """Epipolar distance of both tips, in thirds of a hundredth of the side."""
        cameras = self.space.hull.cameras
        a, b = (_pixels(reading.points[:1], camera) for reading, camera in zip(readings, cameras, strict=True))
        place = triangulate_linear(*cameras, a, b)
        return float(np.linalg.norm(cameras[0].project(place) - a) / (cameras[0].width / 300))


def _pixels(points: NDArray[np.float32], camera: Camera) -> Array:
    return np.asarray(points, float) * (camera.width, camera.height) - 0.5


def _beginning(reading: WireReading, camera: Camera, step: float) -> Array:
    """The curve near the tip, a point every step, px."""
    points = _pixels(reading.points, camera)
    short = _LEAST * step - arc_length(points)[-1]
    if short > 0:  # it goes straight on
        points = np.concatenate([points, points[-1:] + (short + step) * _unit(points[-1] - points[0])])
    length = min(float(arc_length(points)[-1]), _SEEN * camera.width)
    return at_length(points, step * np.arange(int(length / step) + 1))


@functools.lru_cache(maxsize=256)
def _smoothing(count: int) -> Array:
    """The (count, count) matrix that smooths so many points."""
    return np.asarray(savgol_filter(np.eye(count), _WINDOW, 2, axis=0, mode="interp"))


def _unit(vector: Array) -> Array:
    return vector / max(float(np.linalg.norm(vector)), 1e-9)
