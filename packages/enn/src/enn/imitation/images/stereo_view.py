"""Stereo view: what two calibrated fluoroscopic views show in space of devices, vessel and target, from the tip.

The vessel is the visual hull of its two images: the voxels that both show as lumen. Where two vessels overlap in a view
it holds more than the vessels, so the way to the target is sought where it keeps away from the hull's borders: what is
there by chance is thin. The wire's two traces are matched point by point by the epipolar distance.

Places are in metres from the isocentre, directions in the tip's frame: z along the wire and out of its tip, -y towards
where the tip bends.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

Array = NDArray[np.float64]

VOXEL = 2.5e-3  # m
MARGIN = 1.15  # side of the cube of voxels over that of the field
CENTRING = 300.0  # a step k voxels from the hull's border costs 1 + so much over the square of k's length in mm
TRACE_STEP, TRACE_POINTS = 1e-3, 90  # m between the matched points of a trace, and how many from the tip on
NOT_DIAGONAL = 0.002  # of the image's side: what a match costs in which one trace goes on alone
PATH_ARCS = np.array([3, 6, 10, 16, 24, 36, 50]) * 1e-3  # m ahead of the tip: the points of the way that are shown
WIRE_ARCS = np.array([4, 8, 12, 20, 30, 45, 60]) * 1e-3  # m behind the tip: the points of the wire that are shown
TIP_ARC, BEND_ARC = 4e-3, 14e-3  # m: of the wire's direction at the tip, and of the one before it
RAY_STEP, RAY_SAMPLES = 1.5e-3, 20
RAY_SCALE, REMAINING_SCALE, NEAR_SCALE, MOTION_SCALE, MISMATCH_SCALE = 0.015, 0.2, 0.02, 0.01, 0.01
_SMOOTHING = 7  # matched points
_STEPS = np.array([(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if (i, j, k) > (0, 0, 0)])
_RAYS = np.array(
    [(0, 0, 1)]
    + [(x, y, 1) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))]
    + [(x, y, 0) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))],
    float,
)
_RAYS /= np.linalg.norm(_RAYS, axis=1, keepdims=True)

STEREO_SIZE = 6 * len(PATH_ARCS) + 3 * len(WIRE_ARCS) + len(_RAYS) + 23
CATHETER_SIZE = 3  # further numbers where a catheter lies over the wire


@dataclass(frozen=True, eq=False)
class StereoGeometry:
    """Two cameras about an isocentre and the voxels that they see.

    Attributes:
        projections: matrices from homogeneous places (m from the isocentre) to columns and rows as shares of the
            image's side. Shape (2, 3, 4).
        field: side of the square that the views show in the plane of the isocentre, m.
    """

    projections: Array
    field: float

    def __post_init__(self) -> None:
        """Refuses what are not two matrices, and a field that is no length."""
        matrices = np.asarray(self.projections, float)
        if matrices.shape != (2, 3, 4) or not np.isfinite(matrices).all():
            raise ValueError(f"projections: expected two finite matrices, shape (2, 3, 4), got {matrices.shape}")
        if not (np.isfinite(self.field) and self.field > 0):
            raise ValueError(f"field: expected a positive length in m, got {self.field!r}")
        object.__setattr__(self, "projections", matrices)

    @cached_property
    def fundamental(self) -> Array:
        """The fundamental matrix: second^T F first = 0 for places (column, row, 1) of one point. Shape (3, 3)."""
        first, second = self.projections
        source = np.linalg.svd(first)[2][-1]
        a, b, c = second @ source
        return np.array([[0, -c, b], [c, 0, -a], [-b, a, 0]]) @ second @ np.linalg.pinv(first)

    @cached_property
    def side(self) -> int:
        """Voxels along a side of the cube."""
        return int(np.ceil(MARGIN * self.field / VOXEL))

    @cached_property
    def seen(self) -> tuple[Array, NDArray[np.bool_]]:
        """Where the views see each voxel's middle, column and row, shape (2, n^3, 2), and whether both do, (n^3,)."""
        axis = (np.arange(self.side) - (self.side - 1) / 2) * VOXEL
        middles = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
        places = np.stack([_project(matrix, middles) for matrix in self.projections])
        return places, np.all((places > 0) & (places < 1), axis=(0, 2))

    def voxel(self, places: Array) -> Array:
        """Indices, not whole, of places (..., 3) m. Shape (..., 3)."""
        return places / VOXEL + (self.side - 1) / 2

    def place(self, voxels: ArrayLike) -> Array:
        """Middles (..., 3) m of voxels (..., 3)."""
        return (np.asarray(voxels, float) - (self.side - 1) / 2) * VOXEL

    def triangulated(self, first: Array, second: Array) -> Array:
        """Points (n, 3) m whose images (column, row) lie nearest to the places (n, 2) in the two views."""
        rows = [
            place[:, axis, None] * matrix[2] - matrix[axis]
            for matrix, place in zip(self.projections, (first, second), strict=True)
            for axis in (0, 1)
        ]
        equations = np.stack(rows, axis=1)  # (n, 4, 4)
        left, right = equations[..., :3], equations[..., 3]
        normal = left.transpose(0, 2, 1) @ left
        return np.linalg.solve(normal, -(left.transpose(0, 2, 1) @ right[..., None]))[..., 0]

    def apart(self, first: Array, second: Array) -> Array:
        """Distances of places (m, 2) in the second view from the epipolar lines of places (n, 2) in the first, as
        shares of the image's side. Shape (n, m).
        """
        lines = np.column_stack((first, np.ones(len(first)))) @ self.fundamental.T
        lines /= np.maximum(np.hypot(lines[:, 0], lines[:, 1]), 1e-12)[:, None]
        return np.abs(lines @ np.column_stack((second, np.ones(len(second)))).T)


class StereoView:
    """The view from the tip over one episode.

    Args:
        lumens: probability of the vessel's lumen in both views. Each of shape (size, size).
        targets: row and column of the target's dot in both, shares of the image's side. Each of shape (2,).
    """

    def __init__(self, geometry: StereoGeometry, lumens: list[Array], targets: list[Array]) -> None:
        self.geometry = geometry
        self.hull = self._hull_of(lumens)
        first, second = (np.asarray(place, float)[None, ::-1] for place in targets)
        self.target = geometry.triangulated(first, second)[0]
        if not self.hull.any():
            self.hull[tuple(self._clipped(self.target))] = True
        depth = ndimage.distance_transform_edt(self.hull) * VOXEL * 1e3
        self._nearest = ndimage.distance_transform_edt(~self.hull, return_distances=False, return_indices=True)
        self._following, self._numbers, self._inside = self._ways(depth)
        self._before: tuple[Array, Array] | None = None
        self._last: Array | None = None

    def _hull_of(self, lumens: list[Array]) -> NDArray[np.bool_]:
        places, seen = self.geometry.seen
        shown = seen.copy()
        for lumen, place in zip(lumens, places, strict=True):
            size = len(lumen)
            at = np.clip(np.rint(place * size - 0.5).astype(int), 0, size - 1)
            shown &= np.asarray(lumen)[at[:, 1], at[:, 0]] > 0.5
        return shown.reshape((self.geometry.side,) * 3)

    def _clipped(self, place: Array) -> NDArray[np.intp]:
        return np.clip(np.rint(self.geometry.voxel(place)).astype(int), 0, self.geometry.side - 1)

    def _inner(self, place: Array) -> int:
        """Number of the hull's voxel nearest to a place."""
        return int(self._numbers[tuple(self._nearest[:, *self._clipped(place)])])

    def _ways(self, depth: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
        """For each voxel of the hull the next one on its way to the target, negative at the end; their numbers,
        (side, side, side), and their indices, (n, 3).
        """
        side = self.geometry.side
        inside = np.argwhere(self.hull)
        numbers = np.full(self.hull.shape, -1)
        numbers[tuple(inside.T)] = np.arange(len(inside))
        cost = 1.0 + CENTRING / np.maximum(depth[tuple(inside.T)], 0.5) ** 2
        rows, columns, prices = [], [], []
        for step in _STEPS:
            there = inside + step
            ok = np.flatnonzero(((there >= 0) & (there < side)).all(axis=1))
            other = numbers[tuple(there[ok].T)]
            ok, other = ok[other >= 0], other[other >= 0]
            rows.append(ok)
            columns.append(other)
            prices.append(0.5 * (cost[ok] + cost[other]) * np.linalg.norm(step))
        every = (np.concatenate(rows), np.concatenate(columns))
        graph = csr_matrix((np.concatenate(prices), every), shape=(len(inside),) * 2)
        self._numbers = numbers
        end = self._inner(self.target)
        following = dijkstra(graph, directed=False, indices=end, return_predecessors=True)[1]
        return following, numbers, inside

    def way(self, start: Array) -> tuple[Array, float]:
        """The way from a place (3,) m: its points from there on, (n, 3) m, and its length, m."""
        nodes = [self._inner(start)]
        while self._following[nodes[-1]] >= 0:
            nodes.append(int(self._following[nodes[-1]]))
        points = self.geometry.place(self._inside[nodes])
        points[0] = start
        points[-1] = self.target if len(nodes) > 1 else start
        if len(nodes) == 1:
            points = np.stack((start, self.target))
        for _ in range(2):
            if len(points) > 2:
                points[1:-1] = 0.25 * points[:-2] + 0.5 * points[1:-1] + 0.25 * points[2:]
        return points, float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())

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
            wanted = np.arange(min(int(arc[-1] / step) + 1, TRACE_POINTS)) * step
            if len(wanted) < 2:
                wanted = np.array([0.0, max(float(arc[-1]), 1e-6)])
            traces.append(np.stack([np.interp(wanted, arc, axis[:, k]) for k in (1, 0)], axis=1))
            arcs.append(wanted)
        apart = self.geometry.apart(*traces)
        pairs = matched(apart)
        points = self.geometry.triangulated(traces[0][pairs[:, 0]], traces[1][pairs[:, 1]])
        half = min(_SMOOTHING, len(points)) // 2
        if half:
            ahead, behind = 2 * points[0] - points[half:0:-1], 2 * points[-1] - points[-2 : -half - 2 : -1]
            longer = np.concatenate((ahead, points, behind))
            kernel = np.full(2 * half + 1, 1 / (2 * half + 1))
            points = np.stack([np.convolve(longer[:, k], kernel, "valid") for k in range(3)], axis=1)
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
        near, before = (_at(points, arc, np.array([value]))[0] for value in (TIP_ARC, BEND_ARC))
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
        way, remaining = self.way(tip)
        along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))))
        ahead = (_at(way, along, PATH_ARCS) - tip) / PATH_ARCS[:, None]
        behind = (_at(points, arc, WIRE_ARCS) - tip) / WIRE_ARCS[:, None]
        goal = self.target - tip
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
                self._walls(tip, frame) / RAY_SCALE,
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

    def _walls(self, tip: Array, frame: Array) -> Array:
        """Distances (9,) m from the tip to the hull's border."""
        reach = np.arange(1, RAY_SAMPLES + 1) * RAY_STEP
        places = tip + (_RAYS @ frame.T)[:, None] * reach[:, None]
        at = np.clip(np.rint(self.geometry.voxel(places)).astype(int), 0, self.geometry.side - 1)
        return np.minimum.accumulate(self.hull[tuple(np.moveaxis(at, -1, 0))], axis=1).sum(axis=1) * RAY_STEP


def matched(apart: Array) -> NDArray[np.intp]:
    """The cheapest pairs of points of two traces, in order, from the first of both to the end of one of them.

    Args:
        apart: what each pair costs. Shape (n, m).

    Returns:
        Indices into both. Shape (k, 2).
    """
    n, m = apart.shape
    alone = apart + NOT_DIAGONAL
    along = np.cumsum(alone, axis=1)
    total = np.empty((n, m))
    total[0] = along[0] - NOT_DIAGONAL
    for i in range(1, n):
        best = total[i - 1] + alone[i]
        best[1:] = np.minimum(best[1:], total[i - 1, :-1] + apart[i, 1:])
        total[i] = np.minimum.accumulate(best - along[i]) + along[i]
    ends_row, ends_column = int(np.argmin(total[-1])), int(np.argmin(total[:, -1]))
    # the end of one trace: the pair whose mean cost over its length is least
    row = total[-1, ends_row] / max(n + ends_row, 1) <= total[ends_column, -1] / max(ends_column + m, 1)
    i, j = (n - 1, ends_row) if row else (ends_column, m - 1)
    pairs = [(i, j)]
    while i or j:
        options = []
        if i and j:
            options.append((total[i - 1, j - 1], i - 1, j - 1))
        if i:
            options.append((total[i - 1, j] + NOT_DIAGONAL, i - 1, j))
        if j:
            options.append((total[i, j - 1] + NOT_DIAGONAL, i, j - 1))
        _, i, j = min(options)
        pairs.append((i, j))
    return np.array(pairs[::-1])


def _project(matrix: Array, places: Array) -> Array:
    seen = places @ matrix[:, :3].T + matrix[:, 3]
    return seen[:, :2] / seen[:, 2:]


def _at(points: Array, arc: Array, wanted: Array) -> Array:
    return np.stack([np.interp(wanted, arc, points[:, k]) for k in range(points.shape[1])], axis=1)


def _unit(vector: Array, otherwise: Array) -> Array:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 1e-9 else otherwise
