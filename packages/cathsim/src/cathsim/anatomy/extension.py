"""Branches that a file cuts short, extended by a straight tube, so that there is a target in them.

As a flow extension of vascular modelling: the end's cross section goes on along the vessel's direction and becomes
round within a few millimetres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.distance_grid import SignedDistanceGrid, across_frames
from cathsim.anatomy.phantom import END_CLEARANCE
from cathsim.anatomy.vessel_tree import Branch, VesselTree

DEPTH = 30e-3  # m behind the ostium: where a target lies for which a branch is extended
LEAST_DEPTH = 15e-3  # m: nearer to the ostium a place is no target
_ENDING = 5e-3  # m of the branch before its end that give direction and radius
_SECTION = 3e-3  # m before the end: where the cross section is taken from
_OVERLAP = 2e-3  # m before that, where the tube begins within the vessel
_WIDEST = 1.4  # of the tube's radius: no cross section is wider
_ROUND = 6e-3  # m from there over which it becomes round
_APART = 2e-3  # m of wall between the tube and other vessels
_OWN = 0.6  # m a metre of the tube, by which its own vessel, cut aslant, falls behind
_RAYS = 12
_LEAST = 3e-3  # m: a shorter tube is of no use
_STEP = 1e-3  # m between centreline points
_PADDING = 8  # nodes around the tube, a block's edge

Array = NDArray[np.float64]


def extend_short_branches(
    tree: VesselTree, grid: SignedDistanceGrid
) -> tuple[VesselTree, SignedDistanceGrid, tuple[str, ...]]:
    """Extends branches that end open less than `DEPTH` behind their ostium, to `END_CLEARANCE` beyond that depth.

    Returns:
        The tree, the grid, and a note on each branch that was extended, or that another vessel keeps from it.
    """
    branches, notes = list(tree), []
    for number, branch in enumerate(branches):
        if not branch.open_end or branch.parent is None:
            continue
        try:
            depth = branch.length - tree.ostium_arc(branch.name)
        except ValueError:  # it never leaves its parent's lumen
            continue
        if depth >= DEPTH:
            continue
        tube = _Tube.of(branch, grid)
        free = tube.free_length(grid, np.ceil((DEPTH + END_CLEARANCE - depth) / _STEP) * _STEP)
        if free < _LEAST or depth + free < LEAST_DEPTH + END_CLEARANCE:
            notes.append(
                f"{branch.name} ends {1e3 * depth:.0f} mm behind its ostium: another vessel is in the way of more"
            )
            continue
        branches[number], grid = tube.joined(branch, free), tube.drawn(grid, free)
        notes.append(
            f"{branch.name} is cut {1e3 * depth:.0f} mm behind its ostium, and extended by {1e3 * free:.0f} mm "
            "along its direction (extend=False leaves it)"
        )
    return VesselTree(tuple(branches)), grid, tuple(notes)


@dataclass(frozen=True)
class _Tube:
    """A straight vessel from a branch's end on.

    Attributes:
        end: (3,) m.
        direction: (3,) unit vector.
        radius: m.
        inner: (3,) m, the centreline's point `_SECTION` before the end.
    """

    end: Array
    direction: Array
    radius: float
    inner: Array

    @classmethod
    def of(cls, branch: Branch, grid: SignedDistanceGrid) -> _Tube:
        ending = branch.arc >= branch.length - _ENDING
        direction = branch.points[-1] - branch.point_at(branch.length - _ENDING)
        radius = max(float(np.median(branch.radius[ending])), 1.5 * grid.spacing)
        inner = branch.point_at(branch.length - _SECTION)
        return cls(branch.points[-1], direction / np.linalg.norm(direction), radius, inner)

    def free_length(self, grid: SignedDistanceGrid, length: float) -> float:
        """How far (m) the tube can go on, `length` at most, before it comes near to another vessel."""
        arc = np.arange(_STEP, length + _APART, _STEP)
        angle = np.arange(_RAYS) * 2 * np.pi / _RAYS
        first, second = (axis[0] for axis in across_frames(self.direction[None]))
        ring = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second
        across = self.radius * np.concatenate([np.zeros((1, 3)), 0.5 * ring, ring])
        places = self.end + arc[:, None, None] * self.direction + across
        low, high = grid.bounds
        beyond = ((places < low) | (places > high)).any(axis=2)  # the grid ends: nothing is there
        outside = np.where(beyond, np.inf, -grid.sample(places)).min(axis=1)
        near = np.flatnonzero(outside < np.minimum(_OWN * arc - _STEP, _APART))
        return float(max(min(length, arc[near[0]] - _APART), 0.0)) if len(near) else float(length)

    def joined(self, branch: Branch, length: float) -> Branch:
        """The branch with the tube's centreline."""
        arc = np.arange(_STEP, length + _STEP / 2, _STEP)
        share = np.minimum(arc / _ROUND, 1.0)
        radius = (1 - share) * branch.radius[-1] + share * self.radius
        points = np.concatenate([branch.points, self.end + arc[:, None] * self.direction])
        return replace(branch, points=points, radius=np.concatenate([branch.radius, radius]))

    def drawn(self, grid: SignedDistanceGrid, length: float) -> SignedDistanceGrid:
        """The grid with the tube in it, on a lattice that is large enough for it."""
        outside, spacing = float(grid.blocks.constant), grid.spacing
        reach = 1.5 * self.radius - outside
        ends = np.stack([self.inner, self.end + length * self.direction])
        low = np.floor((ends.min(axis=0) - reach - grid.origin) / spacing).astype(int)
        high = np.ceil((ends.max(axis=0) + reach - grid.origin) / spacing).astype(int)
        indices = np.stack(np.meshgrid(*map(np.arange, low, high + 1), indexing="ij"), axis=-1).reshape(-1, 3)
        distance = self._distance(grid, grid.coordinates(indices), length)
        some = distance > outside
        indices, distance = indices[some], distance[some].astype(np.float32)
        old, values = grid.blocks.where(lambda values: values > outside)
        before = _padded_low(indices.min(axis=0) - _PADDING)
        shape = np.maximum(grid.shape, indices.max(axis=0) + 1 + _PADDING) + before
        within = ((indices >= 0) & (indices < grid.shape)).all(axis=1)
        known = np.full(len(indices), outside, np.float32)
        known[within] = grid.blocks.at(indices[within])
        nx, ny, nz = (int(n) for n in shape)
        return SignedDistanceGrid.from_nodes(
            np.concatenate([old, indices]) + before,
            np.concatenate([values, np.maximum(known, distance)]),
            (nx, ny, nz),
            grid.origin - before * spacing,
            spacing,
            outside=outside,
        )

    def _distance(self, grid: SignedDistanceGrid, points: Array, length: float) -> Array:
        """Distance (n,) m to the tube's wall, positive inside; its first plane is that of the cross section."""
        height = (points - self.inner) @ self.direction
        across = points - self.inner - height[:, None] * self.direction
        total = length + float((self.end - self.inner) @ self.direction)
        share = np.clip(height / _ROUND, 0.0, 1.0)
        share = share**2 * (3 - 2 * share)
        aside = np.linalg.norm(across, axis=1)
        own = np.minimum(grid.sample(self.inner + across), _WIDEST * self.radius - aside)  # and no other vessel's
        wall = (1 - share) * own + share * (self.radius - aside)
        cap = np.minimum(total - height, height + _OVERLAP)
        beside = np.hypot(np.minimum(wall, 0.0), np.minimum(cap, 0.0))
        return np.where((wall < 0) | (cap < 0), -beside, np.minimum(wall, cap))


def _padded_low(lowest: NDArray[np.int64]) -> NDArray[np.int64]:
    """Whole blocks of nodes by which a lattice must grow at its lower sides for a lowest index (3,)."""
    return np.maximum(-(lowest // _PADDING), 0) * _PADDING
