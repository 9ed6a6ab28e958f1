"""A vessel tree from rough ways: centrelines moved to the middle of their vessels and smoothed, radii measured."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.centreline import arc_length, resampled, smoothed
from cathsim.anatomy.distance_grid import SignedDistanceGrid, wall_distances
from cathsim.anatomy.extension import LEAST_DEPTH
from cathsim.anatomy.mesh.branches import RoughVessel
from cathsim.anatomy.vessel_tree import Branch, VesselTree, nearest_on_branch

STEP = 1e-3  # m between centreline points
_LEAST_LENGTH = 6e-3  # m outside its parent that a branch must have to be kept
_ROUNDS = 10
_RAYS = 24
_SIDE = 1.3  # median radii beyond which a ray is taken to look into another vessel
_FORK = 1.3  # radii by which a fork lies before the place where the ways part
_AT_ONCE = 8e-3  # m along the aorta within which two vessels' origins keep their order
_END_SETBACK = 3e-3  # m from a flat end at which radii are still measured

Array = NDArray[np.float64]


def grow_tree(
    aorta: RoughVessel, names: Mapping[int, str], grid: SignedDistanceGrid, least_radius: float
) -> tuple[VesselTree, tuple[str, ...]]:
    """Makes a vessel tree, and notes on what was left out or cut short.

    Args:
        aorta: the main vessel with its branches, world frame.
        names: of the vessels, by `id()`.
        least_radius: m; where a branch is narrower, it ends.
    """
    notes: list[str] = []
    in_rings: set[str] = set()
    root = _main(aorta, grid)
    branches = [root]
    queue = [(child, root) for child in sorted(aorta.children, key=lambda child: -child.start)]  # from the heart on
    while queue:
        vessel, parent = queue.pop(0)
        name = names[id(vessel)]
        before = [b.parent_arc for b in branches if b.parent == "aorta" and parent is root]
        branch, note = _branch(vessel, name, parent, grid, least_radius, min(before, default=np.inf))
        if note:
            notes.append(note)
        if branch is None:
            continue
        branches.append(branch)
        if vessel.end is not None and vessel.end < 0:
            in_rings.add(name)
        queue += [(child, branch) for child in vessel.children]
    joined_names = in_rings.union(branch.parent for branch in branches if branch.parent)
    # A trunk whose fork was left out ends where it ends.
    whole = [
        b if b.open_end or b.name in joined_names else Branch(b.name, b.points, b.radius, b.parent, b.parent_arc, True)
        for b in branches
    ]
    return VesselTree(tuple(whole)), tuple(notes)


def _main(aorta: RoughVessel, grid: SignedDistanceGrid) -> Branch:
    points = _centred(smoothed(resampled(aorta.points, STEP), 3e-3), grid, 0, smoothing=3e-3, free_ends=True)
    return Branch("aorta", points, measured_radii(points, grid, 0))


def _branch(
    vessel: RoughVessel, name: str, parent: Branch, grid: SignedDistanceGrid, least_radius: float, most: float
) -> tuple[Branch | None, str]:
    raw = smoothed(resampled(vessel.points, STEP), 1.5e-3)
    if vessel.from_fork:
        start_arc = parent.length
        raw = np.concatenate([parent.points[-1:], raw[np.linalg.norm(raw - parent.points[-1], axis=1) > 2e-3]])
        raw = resampled(raw, STEP)
        # Near the fork the cross section is that of both daughters.
        outside = int(np.searchsorted(arc_length(raw), 1.2 * float(parent.radius[-1])))
        outside = min(outside, len(raw) - 3)
    else:
        _, at, distance = nearest_on_branch(parent, raw)
        beyond = np.flatnonzero(distance > parent.radius_at(at))
        if len(beyond) == 0 or len(raw) - beyond[0] < 4:
            return None, f"{name} left out: it does not stand out of {parent.name}"
        first = int(beyond[0])
        start_arc, origin = _origin(raw, first, parent)
        if most < start_arc < most + _AT_ONCE:  # beside a vessel that leaves before it
            start_arc, origin = most, parent.point_at(most)
        raw = resampled(np.concatenate([origin[None], raw[first:]]), STEP)
        _, at, distance = nearest_on_branch(parent, raw)
        outside = int(np.flatnonzero(distance > parent.radius_at(at))[0])
    points = _centred(raw, grid, outside, smoothing=1.5e-3)
    radius = measured_radii(points, grid, outside)
    if any(child.from_fork for child in vessel.children):
        # Ways part where no ball fills the lumen any more; the daughters' centrelines meet about a radius before.
        keep = max(int(np.searchsorted(arc_length(points), arc_length(points)[-1] - _FORK * radius[-6:].min())), 4)
        keep = max(keep, _deep_enough(points, parent, vessel, grid, least_radius))
        points, radius = points[:keep], radius[:keep]
    narrow = np.flatnonzero((radius < least_radius) & (np.arange(len(points)) >= outside))
    note, open_end = "", vessel.end is not None and vessel.end >= 0
    if len(narrow):
        cut = int(narrow[0])
        note = f"{name} ends where its radius falls below {least_radius * 1e3:.1f} mm"
        points, radius, open_end = points[:cut], radius[:cut], False
    short = (len(points) - 1 - outside) * STEP < _LEAST_LENGTH and not vessel.children
    if len(points) < 4 or short:
        return None, f"{name} left out: it is too short or too narrow for a wire"
    return Branch(name, points, radius, parent.name, start_arc, open_end), note


def _deep_enough(points: Array, parent: Branch, trunk: RoughVessel, grid: SignedDistanceGrid, least: float) -> int:
    """How many points of a trunk reach the least depth (`LEAST_DEPTH`) of a target; 0 where its lumen parts before."""
    first = 0
    if not trunk.from_fork:
        _, at, distance = nearest_on_branch(parent, points)
        beyond = np.flatnonzero(distance >= parent.radius_at(at))
        first = int(beyond[0]) if len(beyond) else len(points)
    count = first + round(LEAST_DEPTH / STEP) + 1
    return count if count <= len(points) and (grid.sample(points[first:count]) >= least).all() else 0


def _origin(raw: Array, first: int, parent: Branch) -> tuple[float, Array]:
    """Where a branch begins on its parent's centreline: straight back from its ostium."""
    ostium = raw[first]
    onward = raw[min(first + 6, len(raw) - 1)] - ostium
    onward /= np.linalg.norm(onward)
    _, at, _ = nearest_on_branch(parent, ostium[None])
    radius = float(parent.radius_at(at[0]))
    back = ostium - np.linspace(0.3 * radius, 2.0 * radius, 40)[:, None] * onward
    _, arcs, distance = nearest_on_branch(parent, back)
    distance = np.where(np.abs(arcs - at[0]) < 1.2 * radius, distance, np.inf)
    best = int(np.argmin(distance)) if np.isfinite(distance).any() else 0
    arc = float(arcs[best]) if np.isfinite(distance[best]) else float(at[0])
    return arc, parent.point_at(arc)


def _centred(
    points: Array, grid: SignedDistanceGrid, outside: int, *, smoothing: float, free_ends: bool = False
) -> Array:
    """Moves a centreline to the middle of its cross sections, from a point on; the first point stays."""
    for _ in range(_ROUNDS):
        tangents = np.gradient(points, axis=0)
        tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
        setback = max(2, round(_END_SETBACK / STEP))
        last = max(len(points) - setback, outside + 1)
        begin = max(outside, setback) if free_ends else outside
        inner = slice(begin, last)
        reach, rays = wall_distances(grid, points[inner], tangents[inner], rays=_RAYS)
        reach = np.minimum(reach, _SIDE * np.median(reach, axis=0))
        shift = (2 / 3) * (reach[..., None] ** 3 * rays).sum(axis=0)
        shift /= np.maximum((reach**2).sum(axis=0), 1e-12)[:, None]
        moved = points.copy()
        moved[inner] += 0.7 * shift
        points = smoothed(moved, smoothing)
    return resampled(points, STEP)


def measured_radii(points: Array, grid: SignedDistanceGrid, outside: int) -> Array:
    """Median distance (n,) m to the wall across the vessel at points (n, 3) m; before `outside`, within the parent's
    lumen, that at the ostium.
    """
    from scipy.ndimage import gaussian_filter1d

    tangents = np.gradient(points, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    index = np.arange(len(points))
    setback = round(_END_SETBACK / STEP)
    begin = outside + 2 if outside else setback
    measured = np.clip(index, min(begin, len(points) - 1), max(len(points) - 1 - setback, 0))
    reach, _ = wall_distances(grid, points[measured], tangents[measured], rays=_RAYS)
    return gaussian_filter1d(np.maximum(np.median(reach, axis=0), 1e-4), 2.0, mode="nearest")
