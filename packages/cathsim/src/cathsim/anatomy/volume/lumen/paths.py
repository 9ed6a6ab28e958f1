"""Paths of labelled vessels: the aorta's and the ends of each vessel, and the rough vessels along them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.centreline import arc_length, resampled, smoothed
from cathsim.anatomy.mesh.branches import RoughVessel
from cathsim.anatomy.vessel_names import AORTA
from cathsim.anatomy.volume.labels.family import Family
from cathsim.anatomy.volume.lumen.graph import LumenGraph
from cathsim.anatomy.volume.lumen.union import FlatEnd

_INFERIOR = 0.3  # how much a lower place speaks for the descending end, against one further back
_ACCESS = ("iliac_right", "iliac_left")  # by which a wire comes in, the usual side first
# Vessels that leave the aorta before, and after, in the order from the heart on: an aberrant RSA may do either.
_EARLY = ("bca", "rcca", "carotid_trunk", "lcca")
_LATE = ("lsa", "celiac", "mesenteric", "renal")
_WHOLE = 0.98  # share of a vessel's nodes that hang together by themselves
_LEAST_APART = 3e-3  # m along the aorta between them, from which on their order counts
AT_TIP = (1.5, 3e-3)  # radii and m before a vessel's tip within which others leave its end
_THIN = (0.55, 1.6e-3)  # of a vessel's radius, and m: what is narrower, for longer than AT_TIP, is no end of it

Array = NDArray[np.float64]


_STEP = 1e-3  # m along ways
_AWAY = (1.2, 6e-3)  # radii of the parent and m from its path: a take-off further off is at the end of a stub of it


@dataclass(eq=False)
class VesselPaths:
    """Where labelled vessels run, in the graph of their lumen."""

    graph: LumenGraph
    which: NDArray[np.uint8]  # (n,) number of the vessel that each node belongs to
    family: Family
    main: list[int]  # vessels that the main path follows, from the access site
    start: int  # node of the main path's first end
    last: int  # of its other end
    tips: dict[int, int] = field(default_factory=dict)  # node of the far end by vessel; none where others go on from it
    forks: dict[int, int] = field(default_factory=dict)  # node where a vessel's daughters part, by vessel
    thin: dict[int, float] = field(default_factory=dict)  # m of a thin stretch beyond a vessel's tip, by vessel
    against_axes: bool = False  # whether the order of the branches puts the heart where the patient's axes do not

    def nodes_of(self, *numbers: int) -> NDArray[np.bool_]:
        """Which nodes (n,) belong to vessels."""
        return np.isin(self.which, numbers)

    def children(self, number: int) -> list[int]:
        """Vessels that leave a vessel."""
        return [n for n, link in self.family.links.items() if link.parent == number]


def find_paths(graph: LumenGraph, which: NDArray[np.uint8], family: Family, ostia: dict[int, Array]) -> VesselPaths:
    """Finds the ends of all vessels.

    Args:
        graph: of the lumen, patient's axes (left, posterior, superior).
        ostia: (3,) m, middle of each vessel's take-off.
    """
    root = family.order[0]
    mine = which == root
    first, second = _far_ends(graph, mine)
    numbers = {name: number for number, name in family.names.items()}
    access = next((numbers[name] for name in _ACCESS if name in numbers), None)
    main = [root]
    against_axes = False
    if access is not None and family.links[access].parent == root:
        # the aorta's end at the take-off is none: the way goes on to the groin
        gaps = [np.linalg.norm(graph.points[node] - ostia[access]) for node in (first, second)]
        lower, upper = (first, second) if gaps[0] < gaps[1] else (second, first)
        main = [access, root]
        while onward := [n for n in family.links if family.links[n].parent == main[0] and _onward(family.names[n])]:
            main.insert(0, onward[0])
        lower = _farthest(graph.away(upper, np.isin(which, main)))
    else:
        height = [graph.points[n][2] * _INFERIOR - graph.points[n][1] for n in (first, second)]
        lower, upper = (first, second) if height[0] < height[1] else (second, first)
        against_axes = _late_before_early(graph, mine, upper, family, ostia)
        if against_axes:
            lower, upper = upper, lower
    paths = VesselPaths(graph, which, family, main, lower, upper, against_axes=against_axes)
    away = graph.away(lower)
    for number in family.order:
        own = np.flatnonzero((which == number) & np.isfinite(away))
        if number in main or len(own) == 0:
            continue
        radius = float(np.quantile(graph.depth[own], 0.95))
        reach = AT_TIP[0] * radius + AT_TIP[1]
        tip, thin = _tip(graph, own, away, radius, reach)
        if thin > 0:
            paths.thin[number] = thin
        at_tip = [
            n
            for n in paths.children(number)
            if away[tip] - away[graph.nearest(ostia[n], which == number)] < reach + family.links[n].radius
        ]
        if at_tip:
            middle = np.mean([ostia[n] for n in at_tip], axis=0)
            paths.forks[number] = graph.nearest(middle)
        else:
            paths.tips[number] = tip
    return paths


def _late_before_early(
    graph: LumenGraph, mine: NDArray[np.bool_], heart: int, family: Family, ostia: dict[int, Array]
) -> bool:
    """Whether, seen from an end of the aorta, vessels that leave it late come before those that leave it early."""
    along = graph.away(heart)

    def mean_place(names: tuple[str, ...]) -> float:
        branches = [n for n, link in family.links.items() if link.parent == family.order[0]]
        nodes = [graph.nearest(ostia[n], mine) for n in branches if family.names[n].startswith(names)]
        return float(np.mean(along[nodes])) if nodes else float("nan")

    return mean_place(_EARLY) - mean_place(_LATE) > _LEAST_APART  # not so where one of them is missing


def _onward(name: str) -> bool:
    return name.startswith(("external_iliac", "femoral"))


def _tip(graph: LumenGraph, own: NDArray[np.int64], away: Array, radius: float, reach: float) -> tuple[int, float]:
    """The node of a vessel that lies farthest along the lumen, and the length (m) of what is too thin to be its end.

    A bar of a voxel or two, which labels have between vessels, can reach further than the vessel does.
    """
    tip = int(own[np.argmax(away[own])])
    full = own[graph.depth[own] >= min(_THIN[0] * radius, _THIN[1])]
    if len(full) == 0:
        return tip, 0.0
    body = int(full[np.argmax(away[full])])
    if np.linalg.norm(graph.points[tip] - graph.points[body]) <= reach:
        return tip, 0.0
    near = own[np.linalg.norm(graph.points[own] - graph.points[body], axis=1) <= radius]
    end = int(near[np.argmax(away[near])])
    return end, float(away[tip] - away[end])


def _far_ends(graph: LumenGraph, mine: NDArray[np.bool_]) -> tuple[int, int]:
    """The two nodes of a vessel that lie farthest from each other, along the lumen.

    Where a branch is as wide as its parent, as at a coarctation, the branch's nodes can part the parent's: the way then
    leads through them.
    """
    seed = int(np.flatnonzero(mine)[np.argmax(graph.depth[mine])])
    within: NDArray[np.bool_] | None = mine
    if np.isfinite(graph.away(seed, mine)[mine]).mean() < _WHOLE:
        within = None

    def farthest(start: int) -> int:
        return _farthest(np.where(mine, graph.away(start, within), np.inf))

    first = farthest(seed)
    return first, farthest(first)


def _farthest(away: Array) -> int:
    return int(np.argmax(np.where(np.isfinite(away), away, -1.0)))


def rough_vessels(
    paths: VesselPaths, ends: dict[int, FlatEnd], first: FlatEnd, ostia: dict[int, Array]
) -> tuple[RoughVessel, dict[int, str]]:
    """The vessels' paths as a tree of rough vessels, and their names by `id()`.

    Args:
        ends: flat ends of vessels; that of the main path's upper end under the aorta's number.
        first: flat end where the main path begins.
    """
    graph, family = paths.graph, paths.family
    root = family.order[0]
    names: dict[int, str] = {}

    def followed(number: int, start: int, end: int, *, head: Array, tail: Array | None) -> tuple[Array, Array]:
        mine = paths.nodes_of(*paths.main) if number == root else paths.nodes_of(number)
        way = graph.way(start, end, mine)
        points, depth = graph.points[way], graph.depth[way]
        if tail is not None:
            points, depth = np.concatenate([points, tail[None]]), np.append(depth, depth[-1])
        lead = np.linspace(0.0, 1.0, max(int(np.linalg.norm(points[0] - head) / _STEP), 1), endpoint=False)
        points = np.concatenate([head + lead[:, None] * (points[0] - head), points])
        return points, np.concatenate([np.full(len(lead), depth[0]), depth])

    mine = paths.nodes_of(*paths.main)
    lower, upper = (graph.nearest(_before(end), mine) for end in (first, ends[root]))
    points, depth = followed(root, lower, upper, head=first.centre, tail=ends[root].centre)
    aorta = RoughVessel(points, depth, root)
    names[id(aorta)] = AORTA
    # a path from the groin on is the aorta's as a whole
    made = dict.fromkeys(paths.main, aorta)
    for number in family.order:
        if number in paths.main or family.links[number].parent not in made:
            continue
        link = family.links[number]
        parent = made[link.parent]
        mine = paths.which == number
        if not mine.any():
            continue
        begin = graph.nearest(ostia[number], mine)
        end = paths.forks.get(number, paths.tips.get(number, begin))
        # the first way led to the vessel's rounded tip; it now ends in its flat end
        flat = ends.get(number)
        if flat is not None:
            end = graph.nearest(_before(flat), mine)
        at_fork = paths.forks.get(link.parent) is not None and _leaves_end(paths, number, ostia)
        foot = (
            len(parent.points) - 1 if at_fork else int(np.argmin(np.linalg.norm(parent.points - ostia[number], axis=1)))
        )
        points, depth = followed(
            number, begin, end, head=parent.points[foot], tail=None if flat is None else flat.centre
        )
        gap = float(np.linalg.norm(parent.points[foot] - graph.points[begin]))
        if not at_fork and gap > _AWAY[0] * parent.depth[foot] + _AWAY[1]:
            # its parent's label holds its first stretch: no straight line leads back
            both = paths.nodes_of(number, *(paths.main if link.parent in paths.main else (link.parent,)))
            back = graph.way(graph.nearest(parent.points[foot], both), begin, both)
            own = int(np.argmin(np.linalg.norm(points - graph.points[begin], axis=1)))
            points = np.concatenate([graph.points[back], points[own + 1 :]])
            depth = np.concatenate([graph.depth[back], depth[own + 1 :]])
        vessel = RoughVessel(points, depth, None if number in paths.forks else number, from_fork=at_fork)
        vessel.start = float(arc_length(parent.points)[foot])
        parent.children.append(vessel)
        names[id(vessel)] = family.names[number]
        made[number] = vessel
    for vessel in made.values():
        vessel.children.sort(key=lambda child: child.start)
    return aorta, names


def _before(end: FlatEnd) -> Array:
    """A place (3,) m in the middle of a vessel right before its flat end."""
    return end.centre - min(0.5 * end.radius, 3e-3) * end.normal


def _leaves_end(paths: VesselPaths, number: int, ostia: dict[int, Array]) -> bool:
    """Whether a vessel goes on from its parent's end, rather than leaves it at its side."""
    parent = paths.family.links[number].parent
    fork = paths.graph.points[paths.forks[parent]]
    own = paths.which == parent
    radius = float(np.quantile(paths.graph.depth[own], 0.95))
    return float(np.linalg.norm(ostia[number] - fork)) < 2 * radius + paths.family.links[number].radius + AT_TIP[1]


def narrow_places(paths: VesselPaths, number: int, begin: int, end: int, least: float) -> tuple[Array, float]:
    """Places (n, 3) m along a vessel's path where it is narrower than a radius (m), and the least depth there, m."""
    from scipy.ndimage import binary_dilation
    from scipy.spatial import cKDTree

    way = paths.graph.way(begin, end, paths.nodes_of(number))
    if len(way) < 2:  # a stub that ends where it begins
        return paths.graph.points[:0], least
    points = smoothed(resampled(paths.graph.points[way], 0.5 * _STEP), 2 * _STEP)
    if len(points) < 4:
        return points[:0], least
    _, nearest = cKDTree(paths.graph.points[way]).query(points)
    depth = paths.graph.depth[way][nearest]
    from_end = arc_length(points[::-1])[::-1]
    narrow = (depth < least) & (from_end > 2 * least)
    reach = round(2 * least / (0.5 * _STEP))
    wide = binary_dilation(narrow, np.ones(2 * reach + 1))
    return points[wide & (from_end > least)], float(depth[narrow].min()) if narrow.any() else least
