"""Where a point is in a vessel tree, by branch and depth; and targets that are points, given in metres or by number."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cathsim.anatomy.distance_grid import SignedDistanceGrid
from cathsim.anatomy.vessel_tree import VesselTree, nearest_on_branch

Point = tuple[float, float, float]  # m, world frame
TargetLike = str | Sequence[float] | NDArray[np.floating]

_SAME = 1e-6  # m: branches of a fork leave at the same place
_DRAWN = re.compile(r"point_([1-9][0-9]{0,3})")
_DRAWN_STREAM = 7  # of the random numbers of drawn points
_FARTHEST = 10.0  # m: a coordinate beyond was meant in another unit
_POINT = re.compile(r"point_(-?[0-9.]+)_(-?[0-9.]+)_(-?[0-9.]+)_mm")
_ALONG = re.compile(r"(\w+)@([0-9]+(?:\.[0-9]+)?)")
_DEEP = 1e-3  # m: a point this far inside the wall is well within the lumen


class Place(NamedTuple):
    """A place in a vessel tree.

    Attributes:
        branch: the branch whose lumen it is in; the root's name before every ostium.
        depth: m along the branch's centreline, from its ostium; 0 in the root.
        arc: m along the branch's centreline, from its first point.
    """

    branch: str
    depth: float
    arc: float


class BranchDepths:
    """Places of points in one vessel tree; a point costs some microseconds.

    A point is in the branch of which it is fewest radii away. Before that branch's ostium it is in the parent's lumen.
    """

    def __init__(self, tree: VesselTree) -> None:
        self._parents = [tree.names.index(b.parent) if b.parent is not None else -1 for b in tree]
        self._tree, ends = tree, np.cumsum([len(branch.points) for branch in tree]).tolist()
        self._spans = list(zip([0, *ends[:-1]], ends, strict=True))
        self._owner = np.repeat(np.arange(len(ends)), np.diff([0, *ends])).tolist()
        self._arc = np.concatenate([branch.arc for branch in tree])
        self._points = np.concatenate([branch.points for branch in tree])
        self._tangents = np.concatenate([branch.tangents for branch in tree])
        # squared distance over squared radius, as one product: (|p|^2 - 2 p.x + |x|^2) / r^2
        squares = np.square(self._points).sum(axis=1, keepdims=True)
        terms = np.concatenate([squares, -2 * self._points, np.ones_like(squares)], axis=1)
        self._terms = terms / np.square(np.concatenate([branch.radius for branch in tree]))[:, None]

    @cached_property
    def _ostia(self) -> list[float]:
        return [_ostium_arc(self._tree, name) for name in self._tree.names]

    def place(self, point: ArrayLike) -> Place:
        """The place of a point (3,) m, world frame."""
        x, y, z = np.asarray(point, np.float64).tolist()
        scores = self._terms @ (1.0, x, y, z, x * x + y * y + z * z)
        nearest = int(scores.argmin())
        number = self._owner[nearest]
        arc = self._along(nearest, x, y, z)
        while number and arc <= self._ostia[number]:
            number = self._parents[number]
            first, last = self._spans[number]
            arc = self._along(first + int(scores[first:last].argmin()), x, y, z)
        depth = arc - self._ostia[number] if number else 0.0
        return Place(self._tree.names[number], depth, arc)

    def _along(self, nearest: int, x: float, y: float, z: float) -> float:
        """Arc length m of a point's foot on the tangent at its nearest centreline point."""
        (px, py, pz), (tx, ty, tz) = self._points[nearest].tolist(), self._tangents[nearest].tolist()
        last = self._spans[self._owner[nearest]][1]
        arc = float(self._arc[nearest]) + (x - px) * tx + (y - py) * ty + (z - pz) * tz
        return min(max(arc, 0.0), float(self._arc[last - 1]))

    def way(self, place: Place, goal: Place) -> float:
        """Way, m along the centrelines, between a goal and a place in its branch or in one that leaves that further on.

        Returns:
            Infinity for a place in any other branch.
        """
        name, arc = place.branch, place.arc
        way = 0.0
        while name != goal.branch:
            branch = self._tree[name]
            if branch.parent is None or (branch.parent == goal.branch and branch.parent_arc < goal.arc - _SAME):
                return math.inf
            way, name, arc = way + arc, branch.parent, branch.parent_arc
        return way + abs(arc - goal.arc)


def _ostium_arc(tree: VesselTree, name: str) -> float:
    """As `VesselTree.ostium_arc`; infinity for a branch that never leaves its parent's lumen."""
    try:
        return tree.ostium_arc(name)
    except ValueError:
        return math.inf


def as_target(target: object) -> str | Point:
    """A target's name as it is, or three coordinates as floats; a point's name (`target_name`) is that point.

    Raises:
        ValueError: it is neither a name nor three finite numbers.
    """
    if isinstance(target, str):
        named = _POINT.fullmatch(target)
        if named is None:
            return target
        target = [1e-3 * float(millimetres) for millimetres in named.groups()]
    try:
        x, y, z = (float(coordinate) for coordinate in target)  # type: ignore[attr-defined]
    except (TypeError, ValueError):
        x = y = z = np.nan
    if not np.isfinite((x, y, z)).all():
        raise ValueError(f"a target is a name, or a point of three coordinates in m, got {target!r}")
    if max(abs(x), abs(y), abs(z)) > _FARTHEST:
        raise ValueError(f"a target's coordinates are in metres, in the world frame, got {(x, y, z)}")
    return x, y, z


def target_name(target: str | Point) -> str:
    """What a target is called; that of a point fits into a file's name."""
    if isinstance(target, str):
        return target
    return "point_{:.1f}_{:.1f}_{:.1f}_mm".format(*(1e3 * coordinate for coordinate in target))


def drawn_point_name(number: int) -> str:
    """What the point of a number, counted from 1, is called as a target of any phantom: "point_3"."""
    return f"point_{number}"


def drawn_point(name: str, phantom: str, tree: VesselTree, grid: SignedDistanceGrid) -> Point | None:
    """The point that a target's name such as "point_3" stands for: drawn from the centrelines beyond the root's.

    Which one it is depends on the phantom's name and the number alone, not on how many others are asked for.

    Returns:
        m, world frame; None: the name is none of a drawn point, or there are no branches.
    """
    numbered = _DRAWN.fullmatch(name)
    points = points_beyond_root(tree, grid) if numbered and len(tree.branches) > 1 else ()
    if numbered is None or not len(points):
        return None
    generator = np.random.default_rng((_DRAWN_STREAM, int(numbered[1]), *phantom.encode()))
    x, y, z = points[int(generator.integers(len(points)))].tolist()
    return x, y, z


def depth_in_branch(name: str) -> tuple[str, float] | None:
    """The branch and the depth behind its ostium, m, that a target's name such as "rcca@80" (mm) stands for."""
    match = _ALONG.fullmatch(name)
    return None if match is None else (match[1], 1e-3 * float(match[2]))


def require_inside(point: Point, grid: SignedDistanceGrid, phantom: str, what: str = "target") -> None:
    """Raises ValueError for a point outside the lumen, with the nearest place inside it; `what` the point is."""
    if (grid.bounds[0] <= point).all() and (point <= grid.bounds[1]).all() and grid.sample(point) > 0:
        return
    inside = grid.coordinates(grid.inside())
    away = np.linalg.norm(inside - point, axis=1)
    nearest = inside[np.argmin(away)]
    raise ValueError(
        f"the {what} {_written(point)} lies outside the lumen of {phantom}: the nearest place inside is "
        f"{_written(nearest)}, {away.min() * 1e3:.3g} mm away; coordinates are in metres, in the world frame"
    )


def _written(point: Sequence[float] | NDArray[np.float64]) -> str:
    return "({:.4g}, {:.4g}, {:.4g}) m".format(*point)


def nearest_branch(point: Point, tree: VesselTree) -> tuple[str, float, float]:
    """The branch of which a point is fewest radii away; arc length along it, m; distance from its centreline, m."""
    candidates = []
    for branch in tree:
        _, arc, distance = (values[0] for values in nearest_on_branch(branch, np.array([point])))
        candidates.append((float(distance / branch.radius_at(arc)), branch.name, float(arc), float(distance)))
    return min(candidates)[1:]


def points_beyond_root(tree: VesselTree, grid: SignedDistanceGrid) -> NDArray[np.float64]:
    """Points (n, 3) m on the centrelines of all branches but the root's: outside its lumen, and within their own."""
    points = np.concatenate([branch.points for branch in tree.branches[1:]])
    _, arc, distance = nearest_on_branch(tree.root, points)
    return points[(distance > tree.root.radius_at(arc)) & (grid.sample(points) > _DEEP)]
