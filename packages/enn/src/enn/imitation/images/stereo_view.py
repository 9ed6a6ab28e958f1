"""Stereo view: what two calibrated fluoroscopic views show in space of devices, vessel and target, from the tip.

The vessel is the visual hull of its two images; the wire's two traces are matched point by point by the epipolar
distance.

Places are in metres from the isocentre, directions in the tip's frame: z along the wire and out of its tip, -y towards
where the tip bends.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from enn.imitation.images.stereo_geometry import matched
from enn.imitation.images.visual_hull import SeenVoxels, VisualHull
from enn.imitation.images.wire_tracing import at_arcs, smoothed

Array = NDArray[np.float64]

TRACE_STEP, TRACE_POINTS = 1e-3, 90  # m between the matched points of a trace, and how many from the tip on
# arcs and rays are those of the teacher's roadmap, which the policy learns to predict
PATH_ARCS = np.array([3, 6, 10, 16, 24, 36, 50]) * 1e-3  # m ahead of the tip: the points of the way that are shown
WIRE_ARCS = np.array([4, 8, 12, 20, 30, 45, 60]) * 1e-3  # m behind the tip: the points of the wire that are shown
TIP_ARC, BEND_ARC = 4e-3, 14e-3  # m: of the wire's direction at the tip, and of the one before it
RAY_SCALE, REMAINING_SCALE, NEAR_SCALE, MOTION_SCALE, MISMATCH_SCALE = 0.015, 0.2, 0.02, 0.01, 0.01
_SMOOTHING = 7  # matched points
_RAYS = np.array(
    [(0, 0, 1)]
    + [(x, y, 1) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))]
    + [(x, y, 0) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))],
    float,
)
_RAYS /= np.linalg.norm(_RAYS, axis=1, keepdims=True)

_SIZES = {
    "ahead": 3 * len(PATH_ARCS),
    "ahead_in_patient": 3 * len(PATH_ARCS),
    "remaining": 2,
    "goal": 4,
    "behind": 3 * len(WIRE_ARCS),
    "walls": len(_RAYS),
    "heading": 3,
    "bend": 3,
    "sine": 1,
    "motion": 3,
    "turn": 3,
    "tip": 3,
    "missed": 1,
}
STEREO_SIZE = sum(_SIZES.values())
_ENDS = np.cumsum(list(_SIZES.values())).tolist()
PARTS = {name: slice(end - size, end) for (name, size), end in zip(_SIZES.items(), _ENDS, strict=True)}  # of a look
CATHETER_SIZE = 3  # further numbers where a catheter lies over the wire


class StereoView:
    """The view from the tip over one episode.

    Args:
        voxels: of the two cameras.
        lumens: probability of the vessel's lumen in both views. Each of shape (size, size).
        targets: row and column of the target's dot in both, shares of the image's side. Each of shape (2,).
    """

    def __init__(self, voxels: SeenVoxels, lumens: list[Array], targets: list[Array]) -> None:
        self.geometry = voxels.geometry
        first, second = (np.asarray(place, float)[None, ::-1] for place in targets)
        self.hull = VisualHull(voxels, lumens, self.geometry.triangulated(first, second)[0])
        self._before: tuple[Array, Array] | None = None

    def wire(self, axes: list[Array]) -> tuple[Array, Array, float]:
        """The wire in space, from its traces in the two views.

        Args:
            axes: rows and columns from the tip on, shares of the image's side. Each of shape (n, 2).

        Returns:
            Points (m, 3) m from the tip on; for each the arcs in both traces, (m, 2) shares of the image's side; how
            far they miss the epipolar lines on average, m.
        """
        step = TRACE_STEP / self.geometry.field
        traces, arcs = [], []
        for axis in axes:
            arc = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(axis, axis=0).T))))
            lengths = np.arange(min(int(arc[-1] / step) + 1, TRACE_POINTS)) * step
            if len(lengths) < 2:
                lengths = np.array([0.0, max(float(arc[-1]), 1e-6)])
            traces.append(np.stack([np.interp(lengths, arc, axis[:, k]) for k in (1, 0)], axis=1))
            arcs.append(lengths)
        apart = self.geometry.apart(*traces)
        pairs = matched(apart)
        triangulation = self.geometry.triangulated(traces[0][pairs[:, 0]], traces[1][pairs[:, 1]])
        points = smoothed(triangulation, _SMOOTHING)
        both = np.stack((arcs[0][pairs[:, 0]], arcs[1][pairs[:, 1]]), axis=1)
        return points, both, float(apart[tuple(pairs[:20].T)].mean()) * self.geometry.field

    def look(self, axes: list[Array], catheter_arcs: tuple[float, float] | None = None) -> NDArray[np.float32]:
        """What both views show from the tip.

        Args:
            axes: rows and columns of the devices' axis in the two views from the tip on, shares of the image's side.
                Each of shape (n, 2).
            catheter_arcs: where a catheter ends on them, lengths from the tip in the same unit; None: there is none.

        Returns:
            Points of the way ahead over their distances, in the tip's frame (21) and in that of the patient (21);
            length of the way and its hyperbolic tangent (2); the target's direction and the hyperbolic tangent of its
            distance (4); points of the wire behind over their distances (21); distances to the hull's border (9); the
            tip's direction and that towards which it bends in the patient's frame (6), sine of the bend (1); motion of
            the tip (3) and turn of its frame (3) since the last look; the tip's place (3); how well the traces match
            (1). Shape (STEREO_SIZE,); with a catheter the distance along the wire from the tip to its end, its
            hyperbolic tangent, and whether it is near enough to be seen (3) follow.
        """
        points, both, missed = self.wire(axes)
        tip = points[0]
        arc = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
        near, before = (at_arcs(points, arc, np.array([value]))[0] for value in (TIP_ARC, BEND_ARC))
        heading, earlier = _unit(tip - near, np.array([0.0, 0.0, 1.0])), _unit(near - before, np.array([0.0, 0.0, 1.0]))
        bend = heading - earlier
        bend = bend - (bend @ heading) * heading
        sine = float(np.linalg.norm(bend))
        down = bend
        if sine < 0.05 and self._before is not None:
            old = -self._before[1][:, 1]
            down = old - (old @ heading) * heading
        fallback = np.cross(heading, [1.0, 0.0, 0.0] if abs(heading[0]) < 0.9 else [0.0, 1.0, 0.0])
        y = -_unit(down, _unit(fallback, np.array([0.0, 1.0, 0.0])))
        frame = np.stack((np.cross(y, heading), y, heading), axis=1)  # columns: x, y, z
        way, remaining = self.hull.way(tip)
        along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))))
        ahead = (at_arcs(way, along, PATH_ARCS) - tip) / PATH_ARCS[:, None]
        behind = (at_arcs(points, arc, WIRE_ARCS) - tip) / WIRE_ARCS[:, None]
        goal = self.hull.target - tip
        away = float(np.linalg.norm(goal))
        last_tip, last_frame = self._before or (tip, frame)
        self._before = tip, frame
        turned = last_frame.T @ frame
        of_catheter: list[Any] = []
        if catheter_arcs is not None:
            reached = np.mean([np.interp(one, both[:, k], arc) for k, one in enumerate(catheter_arcs)])
            seen = float(all(one < both[-1, k] for k, one in enumerate(catheter_arcs)))
            of_catheter = [(reached / REMAINING_SCALE, np.tanh(reached / NEAR_SCALE), seen)]
        return np.concatenate(
            (
                (ahead @ frame).ravel(),
                ahead.ravel(),
                (remaining / REMAINING_SCALE, np.tanh(remaining / NEAR_SCALE)),
                goal @ frame / max(away, 1e-3),
                (np.tanh(away / NEAR_SCALE),),
                (behind @ frame).ravel(),
                self.hull.walls(tip, _RAYS @ frame.T) / RAY_SCALE,
                heading,
                -y,
                (sine,),
                np.clip((tip - last_tip) @ frame / MOTION_SCALE, -5, 5),
                (turned[2, 2], turned[1, 1], turned[0, 1]),
                tip / (self.geometry.field / 2),
                (np.tanh(missed / MISMATCH_SCALE),),
                *of_catheter,
            )
        ).astype(np.float32)


def _unit(vector: Array, otherwise: Array) -> Array:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 1e-9 else otherwise
