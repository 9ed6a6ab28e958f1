"""Labelled vessels along their courses: as a tree of rough vessels, and where they are narrow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.centreline import arc_length, resampled, smoothed
from cathsim.anatomy.mesh.branches import RoughVessel
from cathsim.anatomy.vessel_names import AORTA
from cathsim.anatomy.volume.lumen.courses import AT_TIP, Courses
from cathsim.anatomy.volume.lumen.union import FlatEnd

_STEP = 1e-3  # m along ways
_AWAY = (1.2, 6e-3)  # radii of the parent and m from its course: a take-off further off is at the end of a stub of it

Array = NDArray[np.float64]


def rough_vessels(
    courses: Courses, ends: dict[int, FlatEnd], first: FlatEnd, ostia: dict[int, Array]
) -> tuple[RoughVessel, dict[int, str]]:
    """The vessels' courses as a tree of rough vessels, and their names by `id()`.

    Args:
        ends: flat ends of vessels; that of the main course's upper end under the aorta's number.
        first: flat end where the main course begins.
    """
    graph, family = courses.graph, courses.family
    root = family.order[0]
    names: dict[int, str] = {}

    def followed(number: int, start: int, end: int, *, head: Array, tail: Array | None) -> tuple[Array, Array]:
        mine = courses.nodes_of(*courses.main) if number == root else courses.nodes_of(number)
        way = graph.way(start, end, mine)
        points, depth = graph.points[way], graph.depth[way]
        if tail is not None:
            points, depth = np.concatenate([points, tail[None]]), np.append(depth, depth[-1])
        lead = np.linspace(0.0, 1.0, max(int(np.linalg.norm(points[0] - head) / _STEP), 1), endpoint=False)
        points = np.concatenate([head + lead[:, None] * (points[0] - head), points])
        return points, np.concatenate([np.full(len(lead), depth[0]), depth])

    mine = courses.nodes_of(*courses.main)
    lower, upper = (graph.nearest(_before(end), mine) for end in (first, ends[root]))
    points, depth = followed(root, lower, upper, head=first.centre, tail=ends[root].centre)
    aorta = RoughVessel(points, depth, root)
    names[id(aorta)] = AORTA
    # a course from the groin on is the aorta's as a whole
    made = dict.fromkeys(courses.main, aorta)
    for number in family.order:
        if number in courses.main or family.links[number].parent not in made:
            continue
        link = family.links[number]
        parent = made[link.parent]
        mine = courses.which == number
        if not mine.any():
            continue
        begin = graph.nearest(ostia[number], mine)
        end = courses.forks.get(number, courses.tips.get(number, begin))
        # the first way led to the vessel's rounded tip; it now ends in its flat end
        flat = ends.get(number)
        if flat is not None:
            end = graph.nearest(_before(flat), mine)
        at_fork = courses.forks.get(link.parent) is not None and _leaves_end(courses, number, ostia)
        foot = (
            len(parent.points) - 1 if at_fork else int(np.argmin(np.linalg.norm(parent.points - ostia[number], axis=1)))
        )
        points, depth = followed(
            number, begin, end, head=parent.points[foot], tail=None if flat is None else flat.centre
        )
        gap = float(np.linalg.norm(parent.points[foot] - graph.points[begin]))
        if not at_fork and gap > _AWAY[0] * parent.depth[foot] + _AWAY[1]:
            # its parent's label holds its first stretch: no straight line leads back
            both = courses.nodes_of(number, *(courses.main if link.parent in courses.main else (link.parent,)))
            back = graph.way(graph.nearest(parent.points[foot], both), begin, both)
            own = int(np.argmin(np.linalg.norm(points - graph.points[begin], axis=1)))
            points = np.concatenate([graph.points[back], points[own + 1 :]])
            depth = np.concatenate([graph.depth[back], depth[own + 1 :]])
        vessel = RoughVessel(points, depth, None if number in courses.forks else number, from_fork=at_fork)
        vessel.start = float(arc_length(parent.points)[foot])
        parent.children.append(vessel)
        names[id(vessel)] = family.names[number]
        made[number] = vessel
    for vessel in made.values():
        vessel.children.sort(key=lambda child: child.start)
    return aorta, names


def _before(end: FlatEnd) -> Array:
    """A place (3,) m in the middle of a vessel right before its flat end."""
    place: Array = end.centre - min(0.5 * end.radius, 3e-3) * end.normal
    return place


def _leaves_end(courses: Courses, number: int, ostia: dict[int, Array]) -> bool:
    """Whether a vessel goes on from its parent's end, rather than leaves it at its side."""
    parent = courses.family.links[number].parent
    fork = courses.graph.points[courses.forks[parent]]
    own = courses.which == parent
    radius = float(np.quantile(courses.graph.depth[own], 0.95))
    return float(np.linalg.norm(ostia[number] - fork)) < 2 * radius + courses.family.links[number].radius + AT_TIP[1]


def narrow_places(courses: Courses, number: int, begin: int, end: int, least: float) -> tuple[Array, float]:
    """Places (n, 3) m along a vessel's course where it is narrower than a radius (m), and the least depth there, m."""
    from scipy.ndimage import binary_dilation
    from scipy.spatial import cKDTree

    way = courses.graph.way(begin, end, courses.nodes_of(number))
    if len(way) < 2:  # a stub that ends where it begins
        return courses.graph.points[:0], least
    points = smoothed(resampled(courses.graph.points[way], 0.5 * _STEP), 2 * _STEP)
    if len(points) < 4:
        return points[:0], least
    _, nearest = cKDTree(courses.graph.points[way]).query(points)
    depth = courses.graph.depth[way][nearest]
    from_end = arc_length(points[::-1])[::-1]
    narrow = (depth < least) & (from_end > 2 * least)
    reach = round(2 * least / (0.5 * _STEP))
    wide = binary_dilation(narrow, np.ones(2 * reach + 1))
    return points[wide & (from_end > least)], float(depth[narrow].min()) if narrow.any() else least
