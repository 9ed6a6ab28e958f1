"""Ends of labelled vessels: each is cut flat, across the vessel or by the volume's edge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.centreline import arc_length, last_direction
from cathsim.anatomy.distance_grid import plane_coordinates
from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.volume.lumen.paths import VesselPaths
from cathsim.anatomy.volume.lumen.union import FlatEnd
from cathsim.lattice.node_set import linked_parts

_FULL = 0.8  # of the usual depth, at which a vessel has its full width
_LOOK_BACK = (1.0, 6e-3)  # radii and m of the way before a place that say what is usual: more would cut tapering aortas
_HALF_SECTION = 0.5  # of the section's area, where a rounded end is cut flat
_STEEP = 0.77  # cosine of the angle to the volume's face up to which an end there is left as the face cuts it
_LEAST_CUT = 0.2  # cosine of the angle from which on a face counts as cutting a vessel rather than touching its side
_LOOK_BACK_NODES = 40  # of a way before its tip, whose greatest depth is the vessel's width there

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Tip:
    """Where a vessel ends."""

    node: int  # of the graph
    end: FlatEnd
    cut: bool  # by the volume's edge
    flat: bool = False  # whether that edge is its end as it is


def flat_end(paths: VesselPaths, number: int, tip: int, begin: int, faces: list[tuple[Array, Array, float]]) -> Tip:
    """The flat end of a vessel at its tip.

    Args:
        begin: node from which the vessel is followed.
        faces: points and outward normals of the volume's faces, and how near (m) a tip lies to one that cuts it.
    """
    graph = paths.graph
    mine = paths.nodes_of(*paths.main) if number in paths.main else paths.nodes_of(number)
    way = graph.way(begin, tip, mine)
    face = next(((at, n) for at, n, reach in faces if (at - graph.points[tip]) @ n < reach), None)
    if face is not None:
        # the way to the furthest corner of a section that a face cuts runs aslant: its middle is meant
        wide = 2.5 * float(graph.depth[way[-_LOOK_BACK_NODES:]].max())
        middle = _section_middle(graph.points[mine], graph.points[tip], *face, wide, 2 * graph.spacing)
        way = graph.way(begin, graph.nearest(middle - 2 * graph.spacing * face[1], mine), mine)
    points, depth = graph.points[way], graph.depth[way]
    from_end = arc_length(points[::-1])[::-1]
    index = _full_width(from_end, depth)
    radius = float(np.median(depth[(from_end >= from_end[index]) & (from_end <= from_end[index] + 2 * depth[index])]))
    if index < 1:
        raise MeshRefusedError("a vessel is too short to have an end; take a finer resolution.")
    direction = last_direction(points[: index + 1], 2.5 * radius)
    base = points[index]
    if face is not None and direction @ face[1] > _LEAST_CUT:
        place, normal = face
        steepness = float(direction @ normal)
        to_face = float((place - base) @ normal) / steepness
        if steepness >= _STEEP:
            return Tip(tip, FlatEnd(middle, normal, 1e-4, radius), True, True)
        # a plane across the vessel whose whole section lies before the face
        back = to_face - radius * float(np.sqrt(1 - steepness**2)) / steepness
        if back < 0:
            index = int(np.argmin(np.abs(from_end - (from_end[index] - back))))
            base, back = points[index], 0.0
        return Tip(tip, FlatEnd(base, direction, max(back, 1e-4), radius), True)
    beyond = _half_section(graph.points[mine], base, direction, radius, graph.spacing)
    return Tip(tip, FlatEnd(base, direction, beyond, radius), False)


def _full_width(from_end: Array, depth: Array) -> int:
    """Last point of a way where the vessel has its usual width."""
    for index in range(len(depth) - 1, -1, -1):
        reach = from_end[index] + _LOOK_BACK[0] * depth[index] + _LOOK_BACK[1]
        before = (from_end >= from_end[index]) & (from_end <= reach)
        if depth[index] >= _FULL * depth[before].max():
            return index
    return 0


def _half_section(points: Array, base: Array, normal: Array, radius: float, spacing: float) -> float:
    """How far (m) beyond a base a vessel's section falls to half its area."""
    height, aside = plane_coordinates(points, base, normal)
    near = (aside < 2 * radius) & (height > -radius) & (height < 3 * radius)
    full = np.count_nonzero(near & (height <= 0)) / radius
    for beyond in np.arange(0.0, 3 * radius, spacing):
        count = np.count_nonzero(near & (height > beyond) & (height <= beyond + 2 * spacing)) / (2 * spacing)
        if count < _HALF_SECTION * full:
            return float(beyond + spacing)
    return 3 * radius


def _section_middle(points: Array, tip: Array, place: Array, normal: Array, reach: float, thick: float) -> Array:
    """Middle (3,) m of a lumen's section about a tip: of its points (n, 3) m within `thick` of a plane."""
    from scipy.spatial import cKDTree

    height = (points - place) @ normal
    near = points[(np.abs(height) <= thick) & (np.linalg.norm(points - tip, axis=1) <= reach)]
    middle = tip
    if len(near):  # a plane may cut the aorta twice: what hangs together with the tip counts
        pairs = cKDTree(near).query_pairs(0.9 * thick, output_type="ndarray")
        part = linked_parts(pairs[:, 0], pairs[:, 1], len(near))
        middle = near[part == part[np.argmin(((near - tip) ** 2).sum(axis=1))]].mean(axis=0)
    return middle - float((middle - place) @ normal) * normal
