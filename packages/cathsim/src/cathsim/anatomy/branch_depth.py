"""Where a point is in a vessel tree: the branch, the depth behind the branch's ostium, and the way to other places."""

from __future__ import annotations

import math
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from cathsim.anatomy.vessel_tree import VesselTree

_SAME = 1e-6  # m: branches of a fork leave at the same place


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
