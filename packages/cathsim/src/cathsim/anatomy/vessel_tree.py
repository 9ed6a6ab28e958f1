"""Vessel tree: branches made of a centreline and a radius, joined where each leaves its parent."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cathsim.anatomy.centreline import arc_length

JOIN_TOLERANCE = 1e-3  # m: how far a branch may start from its parent's centreline

Array = NDArray[np.float64]


DIRECTION_LENGTH = 0.012  # m of a branch beyond its ostium that give its direction


@dataclass(frozen=True, eq=False)
class Branch:
    """One vessel: a centreline with a radius at each of its points.

    A branch begins on its parent's centreline, so its first stretch lies inside the parent's lumen.
    """

    name: str  # unique within its tree
    points: Array  # (n, 3) m, world frame, ordered away from the parent
    radius: Array  # (n,) m, lumen radius at each point
    parent: str | None = None  # name of the parent branch, None for the root
    parent_arc: float = 0.0  # arc length (m) along the parent at which this branch begins
    open_end: bool = True  # True where the last point is a flat opening, False where other branches continue it

    def __post_init__(self) -> None:
        points = np.asarray(self.points, dtype=np.float64)
        radius = np.asarray(self.radius, dtype=np.float64)
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "radius", radius)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) < 2:
            raise ValueError(f"branch {self.name!r}: points must have shape (n >= 2, 3), got {points.shape}.")
        if radius.shape != (len(points),):
            raise ValueError(
                f"branch {self.name!r}: radius must have shape ({len(points)},) like its points, got {radius.shape}."
            )
        if not (np.isfinite(points).all() and np.isfinite(radius).all()):
            raise ValueError(f"branch {self.name!r}: points and radius must be finite; remove NaN and infinite values.")
        if radius.min() <= 0:
            raise ValueError(f"branch {self.name!r}: every radius must be positive, the least is {radius.min():g} m.")
        if np.linalg.norm(np.diff(points, axis=0), axis=1).min() <= 0:
            raise ValueError(f"branch {self.name!r}: consecutive points must differ; remove duplicates.")

    @cached_property
    def arc(self) -> Array:
        """Arc length (n,) m at every point, zero at the first."""
        return arc_length(self.points)

    @property
    def length(self) -> float:
        """Arc length of the whole branch, m."""
        return float(self.arc[-1])

    @cached_property
    def tangents(self) -> Array:
        """Unit tangents (n, 3) at every point, pointing away from the parent."""
        tangents = np.gradient(self.points, self.arc, axis=0)
        return tangents / np.linalg.norm(tangents, axis=1, keepdims=True)

    def point_at(self, arc: ArrayLike) -> Array:
        """Centreline points (..., 3) m at arc lengths (...,) m, which are clamped to the branch."""
        return self._interpolate(arc, self.points)

    def tangent_at(self, arc: ArrayLike) -> Array:
        """Unit tangents (..., 3) at arc lengths (...,) m, which are clamped to the branch."""
        tangents = self._interpolate(arc, self.tangents)
        return tangents / np.linalg.norm(tangents, axis=-1, keepdims=True)

    def radius_at(self, arc: ArrayLike) -> Array:
        """Lumen radii (...,) m at arc lengths (...,) m, which are clamped to the branch."""
        return np.interp(np.asarray(arc, dtype=np.float64), self.arc, self.radius)

    def _interpolate(self, arc: ArrayLike, values: Array) -> Array:
        arc = np.asarray(arc, dtype=np.float64)
        return np.stack([np.interp(arc, self.arc, values[:, k]) for k in range(3)], axis=-1)


@dataclass(frozen=True, eq=False)
class VesselTree:
    """Branches joined into one tree: the root first, every parent before its children."""

    branches: tuple[Branch, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "branches", tuple(self.branches))
        seen: dict[str, Branch] = {}
        for index, branch in enumerate(self.branches):
            if branch.name in seen:
                raise ValueError(f"branch names must be unique, {branch.name!r} appears twice.")
            if (branch.parent is None) != (index == 0):
                raise ValueError(f"the first branch alone has no parent; look at {branch.name!r} at place {index}.")
            if branch.parent is not None:
                if branch.parent not in seen:
                    raise ValueError(f"branch {branch.name!r}: its parent {branch.parent!r} must come before it.")
                parent = seen[branch.parent]
                if not 0 <= branch.parent_arc <= parent.length + JOIN_TOLERANCE:
                    raise ValueError(
                        f"branch {branch.name!r}: parent_arc must lie in [0, {parent.length:g}] m of {parent.name!r}, "
                        f"got {branch.parent_arc:g}."
                    )
                gap = float(np.linalg.norm(parent.point_at(branch.parent_arc) - branch.points[0]))
                if gap > JOIN_TOLERANCE:
                    raise ValueError(
                        f"branch {branch.name!r} must begin on the centreline of {parent.name!r} at parent_arc: "
                        f"it begins {gap * 1e3:.2f} mm away."
                    )
            seen[branch.name] = branch
        if not seen:
            raise ValueError("a vessel tree needs at least one branch, got none.")

    def __getitem__(self, name: str) -> Branch:
        for branch in self.branches:
            if branch.name == name:
                return branch
        raise KeyError(f"no branch {name!r}; this tree has {', '.join(self.names)}.")

    def __contains__(self, name: object) -> bool:
        return name in self.names

    def __iter__(self) -> Iterator[Branch]:
        return iter(self.branches)

    @property
    def root(self) -> Branch:
        """The branch without a parent (the aorta)."""
        return self.branches[0]

    @property
    def names(self) -> tuple[str, ...]:
        """Branch names, root first."""
        return tuple(branch.name for branch in self.branches)

    def ancestry(self, name: str) -> tuple[str, ...]:
        """Names from the root down to a branch, both included."""
        chain = [name]
        while (parent := self[chain[-1]].parent) is not None:
            chain.append(parent)
        return tuple(reversed(chain))

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest corner (3,) m of the box around the balls on all centrelines."""
        low = np.min([np.min(b.points - b.radius[:, None], axis=0) for b in self], axis=0)
        high = np.max([np.max(b.points + b.radius[:, None], axis=0) for b in self], axis=0)
        return low, high

    def centred(self) -> VesselTree:
        """The same tree, with the middle of its box at the origin."""
        low, high = self.bounds
        return self.translated(-(low + high) / 2)

    def translated(self, offset: ArrayLike) -> VesselTree:
        """The same tree, moved by (3,) m."""
        offset = np.asarray(offset, dtype=np.float64)
        return VesselTree(
            tuple(
                Branch(b.name, b.points + offset, b.radius, b.parent, b.parent_arc, b.open_end) for b in self.branches
            )
        )

    def ostium_arc(self, name: str) -> float:
        """Arc length (m) along a branch at which it leaves the lumen of its parent; zero for the root.

        A branch that continues its parent's end (a bifurcation) leaves it at zero.
        """
        branch = self[name]
        if branch.parent is None:
            return 0.0
        parent = self[branch.parent]
        if not parent.open_end and branch.parent_arc >= parent.length - JOIN_TOLERANCE:
            return 0.0
        arc = np.arange(0.0, branch.length, 1e-4)
        _, parent_arc, distance = nearest_on_branch(parent, branch.point_at(arc))
        outside = np.flatnonzero(distance >= parent.radius_at(parent_arc))
        if len(outside) == 0:
            raise ValueError(f"branch {name!r} never leaves the lumen of {parent.name!r}; lengthen or redirect it.")
        return float(arc[outside[0]])

    def ostium(self, name: str) -> Array:
        """Centre (3,) m of a branch's ostium, where its centreline leaves the parent's lumen."""
        return self[name].point_at(self.ostium_arc(name))


def nearest_on_branch(branch: Branch, points: ArrayLike) -> tuple[Array, Array, Array]:
    """Nearest centreline points of one branch to points (m, 3) m, by projection onto its segments.

    Returns:
        Nearest points (m, 3) m, their arc lengths (m,) m, and the distances (m,) m.
    """
    from scipy.spatial import cKDTree

    points = np.atleast_2d(np.asarray(points, dtype=np.float64))
    _, vertex = cKDTree(branch.points).query(points)
    best_distance = np.full(len(points), np.inf)
    best_arc = np.zeros(len(points))
    best_point = np.zeros_like(points)
    last = len(branch.points) - 2
    for segment in (np.clip(vertex - 1, 0, last), np.clip(vertex, 0, last)):
        start = branch.points[segment]
        along = branch.points[segment + 1] - start
        length = branch.arc[segment + 1] - branch.arc[segment]
        fraction = np.clip(np.einsum("ij,ij->i", points - start, along) / length**2, 0.0, 1.0)
        foot = start + fraction[:, None] * along
        distance = np.linalg.norm(points - foot, axis=1)
        better = distance < best_distance
        best_distance[better] = distance[better]
        best_arc[better] = (branch.arc[segment] + fraction * length)[better]
        best_point[better] = foot[better]
    return best_point, best_arc, best_distance


def set_back(tree: VesselTree, name: str) -> float:
    """How far the ostium of a branch lies behind the top of the arch, against the branch's own direction, m.

    A wire from the descending aorta lies along the roof of the arch, so this is how far it comes down past the ostium
    and has to come back up within the branch. It is negative where the branch leads on from the top of the arch. Of a
    branch that leaves a trunk the larger of both counts.

    Args:
        name: of a branch.

    Raises:
        ValueError: the aorta itself, or a branch that there is not.
    """
    aorta = tree.root
    chain = tree.ancestry(name)[1:] if name in tree else ()
    if not chain:
        raise ValueError(f"name must be that of a branch, {', '.join(tree.names[1:])}, got {name!r}")
    heights = aorta.points[:, 2] + aorta.radius * np.sqrt(np.maximum(1 - aorta.tangents[:, 2] ** 2, 0))
    highest = int(np.argmax(heights))
    top = np.array([*aorta.points[highest, :2], heights[highest]])
    distances = []
    for vessel in chain:
        branch, begins = tree[vessel], tree.ostium_arc(vessel)
        ostium = branch.point_at(begins)
        direction = branch.point_at(min(begins + DIRECTION_LENGTH, branch.length)) - ostium
        distances.append(float((top - ostium) @ direction / np.linalg.norm(direction)))
    return max(distances)
