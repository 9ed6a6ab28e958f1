"""Shortest paths in the lumen: A* on the distance grid, pulled taut and smoothed without touching the wall."""

from __future__ import annotations

import ctypes
import logging
from dataclasses import dataclass
from itertools import product
from pathlib import Path as FilePath
from typing import Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import ArrayLike, NDArray

from cathsim.anatomy.centreline import arc_length
from cathsim.anatomy.distance_grid import SignedDistanceGrid
from cathsim.lattice.node_blocks import STRIDES
from cathsim.lattice.node_set import NodeSet, NodeSetStruct
from cathsim.presets import WIRE_RADIUS
from cathsim.validation import LengthOrNone, quantity
from cathsim.viewing.figure import new_figure

logger = logging.getLogger(__name__)

Array = NDArray[np.float64]

CLEARANCE = WIRE_RADIUS
_Aversion = Annotated[float, Interval(ge=0, le=1e6)]  # the search needs costs no less than length
_SNAP = 3  # lattice points between an end of the path and the lattice, at most
_AROUND = tuple(step for step in product((-1, 0, 1), repeat=3) if any(step))  # to the 26 neighbours of a node
_STEP = 1e-3  # m between the points of a smoothed path
_ROUNDS = 60
_FOUND, _NO_MEMORY = 0, 2  # what the native search returns


class UnreachableError(ValueError):
    """No way leads through the lumen from start to target."""


@dataclass(frozen=True, eq=False)
class LumenPath:
    """A way through the lumen."""

    points: Array  # (n, 3) m, world frame, from start to target

    def __post_init__(self) -> None:
        points = np.array(self.points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) < 1 or not np.isfinite(points).all():
            raise ValueError(f"a path needs finite points of shape (n, 3) with n >= 1, got shape {points.shape}.")
        points.flags.writeable = False
        object.__setattr__(self, "points", points)

    @property
    def arc(self) -> Array:
        """(n,) m along the path."""
        return arc_length(self.points)

    @property
    def length(self) -> float:
        """m."""
        return float(self.arc[-1])

    def resampled(self, step: float) -> LumenPath:
        """The same path with points about `step` (m) apart, both ends kept."""
        arc = self.arc
        even = np.linspace(0.0, arc[-1], max(2, round(arc[-1] / step) + 1))
        return LumenPath(np.column_stack([np.interp(even, arc, self.points[:, k]) for k in range(3)]))

    def clearance(self, grid: SignedDistanceGrid) -> float:
        """Least distance (m) to the wall along the path; negative where it leaves the lumen."""
        return float(grid.sample(self.resampled(0.25 * grid.spacing).points).min())


def plan_path(
    grid: SignedDistanceGrid,
    start: ArrayLike,
    target: ArrayLike,
    *,
    clearance: float = CLEARANCE,
    preferred_clearance: float = 0.0,
    aversion: float = 4.0,
) -> LumenPath:
    """A smooth short way through the lumen, from start to target themselves.

    Args:
        grid: signed distance to the wall, positive inside.
        start, target: (3,) m, world frame, inside the lumen.
        clearance: m that the path keeps from the wall.
        preferred_clearance: m below which nearness to the wall costs; 0 gives the shortest way.
        aversion: how many times longer a way along the wall may count, on top of its length.

    Raises:
        ValueError: for an end outside the lumen.
        UnreachableError: no way keeps the clearance.
    """
    path = shortest_lattice_path(
        grid, start, target, clearance=clearance, preferred_clearance=preferred_clearance, aversion=aversion
    )
    if preferred_clearance <= clearance:
        # pulled taut, a way that keeps off the wall would go back to it
        path = pull_taut(path, grid, clearance=clearance)
    return smooth_path(path, grid, clearance=clearance)


def shortest_lattice_path(
    grid: SignedDistanceGrid,
    start: ArrayLike,
    target: ArrayLike,
    *,
    clearance: float = CLEARANCE,
    preferred_clearance: float = 0.0,
    aversion: float = 4.0,
) -> LumenPath:
    """Cheapest way over the lattice, by A* with 26 neighbours and the straight distance as its bound.

    Arguments and errors are those of `plan_path`; the aversion falls linearly to none at the preferred clearance.
    Points are the start, the lattice points between, and the target.

    Raises:
        ValueError: for an end outside the lumen, or a clearance or aversion that cannot be meant.
        UnreachableError: no way keeps the clearance.
    """
    clearance = quantity("clearance", clearance, LengthOrNone)
    preferred_clearance = quantity("preferred_clearance", preferred_clearance, LengthOrNone)
    aversion = quantity("aversion", aversion, _Aversion)
    ends = [np.asarray(end, dtype=np.float64) for end in (start, target)]
    free = NodeSet.where(grid.blocks, lambda values: values >= clearance)
    first, last = (
        _nearest_free(grid, end, clearance, name) for end, name in zip(ends, ("start", "target"), strict=True)
    )
    weight = np.ones(len(free), dtype=np.float64)
    if preferred_clearance > 0:
        weight += aversion * np.clip(1.0 - free.values / preferred_clearance, 0.0, 1.0)
    route = _search(free, weight, first, last)
    if route is None:
        raise UnreachableError(
            f"no way through the lumen leads from {_text(ends[0])} to {_text(ends[1])} with {clearance * 1e3:g} mm of "
            "clearance: choose another target or less clearance."
        )
    points = grid.coordinates(route)
    points = np.concatenate([ends[0][None], points, ends[1][None]])
    moved = np.concatenate([[True], np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-9 * grid.spacing])
    return LumenPath(points[moved])


def _search(free: NodeSet, weight: Array, first: NDArray[np.intp], last: NDArray[np.intp]) -> NDArray[np.int32] | None:
    """A* from the target back to the start; lattice indices (n, 3) from start to target, or None.

    Args:
        weight: (n,) cost of a lattice step at each free node.
        first, last: indices (3,) of start and target, free nodes.
    """
    from cathsim.contact.native import address, library

    squares = [(np.arange(n) - i) ** 2.0 for n, i in zip(free.numbers.shape, first, strict=True)]
    x, y, z = (square[free.indices[:, k]] for k, square in enumerate(squares))
    bound, half = np.sqrt(x + y + z), 0.5 * weight
    steps = np.array(_AROUND, dtype=np.int32) @ STRIDES.astype(np.int32)
    lengths = np.sqrt(np.square(_AROUND).sum(axis=1, dtype=np.float64))
    begin, goal = free.number_at(last), free.number_at(first)
    came_from = np.empty(len(free), dtype=np.int32)
    arrays = (address(array) for array in (steps, lengths, half, bound))
    nodes = ctypes.byref(NodeSetStruct.of(free))
    result = library().cathsim_shortest_path(nodes, *arrays, begin, goal, address(came_from))
    if result == _NO_MEMORY:
        raise MemoryError(f"no memory left for a path among {len(free)} grid nodes: use a coarser resolution")
    if result != _FOUND:
        return None
    route = [goal]
    while route[-1] != begin:
        route.append(int(came_from[route[-1]]))
    return free.indices[route]


def _nearest_free(grid: SignedDistanceGrid, end: Array, clearance: float, name: str) -> NDArray[np.intp]:
    """Index (3,) of the free node nearest to an end of the path."""
    if end.shape != (3,) or not np.isfinite(end).all():
        raise ValueError(f"the path's {name} must be three finite coordinates, got {end.tolist()}.")
    index = (end - grid.origin) / grid.spacing
    low = np.clip(np.floor(index) - _SNAP, 0, grid.shape).astype(int)
    high = np.clip(np.ceil(index) + _SNAP + 1, 0, grid.shape).astype(int)
    box = (slice(low[0], high[0]), slice(low[1], high[1]), slice(low[2], high[2]))
    near = np.argwhere(grid.dense(box) >= clearance) + low
    distance = np.linalg.norm(near - index, axis=1)
    if len(near) == 0 or distance.min() > _SNAP:
        raise ValueError(f"the path's {name} {_text(end)} lies outside the lumen: move it inside, away from the wall.")
    return near[np.argmin(distance)]


def _text(point: Array) -> str:
    return "(" + ", ".join(f"{x * 1e3:.1f}" for x in point) + ") mm"


def pull_taut(path: LumenPath, grid: SignedDistanceGrid, *, clearance: float = CLEARANCE) -> LumenPath:
    """Leaves out every point that a straight line can skip that keeps its clearance (m); both ends stay."""
    points = path.points
    corners, corner = [0], 0
    while corner < len(points) - 1:
        visible, hidden = corner + 1, len(points)
        reach = 2
        while hidden - visible > 1:
            # gallop ahead while the line stays free, then halve the interval in which it ends
            trial = min(corner + reach, len(points) - 1) if hidden == len(points) else (visible + hidden) // 2
            if _line_is_free(points[corner], points[trial], grid, clearance):
                visible, reach = trial, 2 * reach
            else:
                hidden = trial
        corners.append(visible)
        corner = visible
    return LumenPath(points[corners])


def _line_is_free(a: Array, b: Array, grid: SignedDistanceGrid, clearance: float) -> bool:
    count = int(np.linalg.norm(b - a) / (0.5 * grid.spacing)) + 2
    return bool(grid.sample(a + np.linspace(0.0, 1.0, count)[:, None] * (b - a)).min() >= clearance)


def smooth_path(path: LumenPath, grid: SignedDistanceGrid, *, clearance: float = CLEARANCE) -> LumenPath:
    """Rounds the corners of a path by averaging neighbours, wherever the result keeps its clearance; both ends stay.

    Args:
        clearance: m to keep from the wall; where the path comes nearer already, it may stay as near as it is.
    """
    points = np.array(path.resampled(_STEP).points)
    if len(points) < 3:
        return LumenPath(points)
    floor = np.minimum(grid.sample(points), clearance)
    floor_between = np.minimum(grid.sample((points[1:] + points[:-1]) / 2), clearance)
    for _ in range(_ROUNDS):
        moved = points.copy()
        moved[1:-1] = 0.5 * points[1:-1] + 0.25 * (points[:-2] + points[2:])
        while True:
            bad = grid.sample(moved) < floor
            between = grid.sample((moved[1:] + moved[:-1]) / 2) < floor_between
            bad[1:] |= between
            bad[:-1] |= between
            bad &= (moved != points).any(axis=1)
            if not bad.any():
                break
            moved[bad] = points[bad]  # back to where it was good; its neighbours are tested again
        points = moved
    return LumenPath(points).resampled(_STEP)


def picture(
    path: LumenPath, grid: SignedDistanceGrid, file: str | FilePath, *, title: str = "Shortest path in the lumen"
) -> FilePath:
    """Saves a picture of a path in the vessel, seen from the front and from the patient's left; returns the file.

    Args:
        file: where the PNG goes; its folder must exist.
    """
    low, high = grid.bounds * 1e3
    points = path.points * 1e3
    figure = new_figure(figsize=(8.0, 6.4), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    views = (("from the front", 1, 0, "x, left (mm)"), ("from the left", 0, 1, "y, posterior (mm)"))
    for plot, (name, through, across, label) in zip(axes, views, strict=True):
        depth = 1e3 * grid.thickness(through)
        half = 500 * grid.spacing
        extent = (low[across] - half, high[across] + half, low[2] - half, high[2] + half)
        plot.imshow(depth.T, origin="lower", extent=extent, cmap="Greys", vmin=0, vmax=1.6 * depth.max())
        silhouette = grid.silhouette(through).T
        scale = [np.linspace(low[k], high[k], grid.shape[k]) for k in (across, 2)]
        plot.contour(*scale, silhouette, levels=[0.0], colors="0.35", linewidths=0.8)
        plot.plot(points[:, across], points[:, 2], color="tab:red", linewidth=1.8)
        plot.plot(*points[0, [across, 2]], "o", color="tab:blue", label="start")
        plot.plot(*points[-1, [across, 2]], "*", color="tab:green", markersize=12, label="target")
        plot.set(title=name, xlabel=label, aspect="equal")
    axes[0].set_ylabel("z, superior (mm)")
    axes[0].legend(loc="lower left", frameon=False)
    clearance = path.clearance(grid)
    figure.suptitle(f"{title}: {path.length * 1e3:.1f} mm, at least {clearance * 1e3:.1f} mm from the wall")
    figure.savefig(file, dpi=120)
    logger.debug("saved the picture of a path to %s", file)
    return FilePath(file)
