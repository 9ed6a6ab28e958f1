"""From a level function to the signed distance to its wall, on a lattice of blocks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.lumen import OUTSIDE
from cathsim.anatomy.volume.lumen.lattice import BlockLattice, Nodes
from cathsim.lattice.node_set import linked_parts

_STEPS = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
_FLAT, _ROUND = 1.0, 2.5  # spacings from the wall up to, and from which on, distances are to planes, and to points
_NEAR = 4.0  # spacings: a level further from zero than this has no neighbour on the wall's other side
_BATCH = 200_000  # nodes worked on at once
_LATERAL = 1.5  # spacings that a foot point may lie aside

Array = NDArray[np.float64]
Field = NDArray[np.float32]


def connected(lattice: BlockLattice, level: Field, start: int) -> NDArray[np.bool_]:
    """Which nodes (n,) with a positive level hang together with the node of a row."""
    rows = np.flatnonzero(level > 0)
    place = np.full(len(level) + 1, -1, dtype=np.int64)
    place[rows] = np.arange(len(rows))
    first, second = [], []
    for step in _STEPS:
        other = place[lattice.neighbours(rows, step)]
        linked = other >= 0
        first.append(np.flatnonzero(linked))
        second.append(other[linked])
    parts = linked_parts(np.concatenate(first), np.concatenate(second), len(rows))
    mask = np.zeros(len(level), dtype=bool)
    mask[rows[parts == parts[place[start]]]] = True
    return mask


def signed_distance(lattice: BlockLattice, level: Field, rows: Nodes | None = None) -> Field:
    """Signed distance (k,) m of nodes to the zero level, positive inside, clamped far outside.

    Args:
        level: (n,) of all nodes, of any slope, positive inside.
        rows: (k,) of some nodes; all where they are left out.
    """
    from scipy.spatial import cKDTree

    points, normals = _wall_points(lattice, level)
    tree = cKDTree(points, balanced_tree=False, compact_nodes=False)
    nodes = np.arange(len(level)) if rows is None else rows
    distances = np.full(len(nodes), OUTSIDE, dtype=np.float32)
    for some in np.array_split(np.arange(len(nodes)), len(nodes) // _BATCH + 1):
        at = lattice.points(lattice.nodes[nodes[some]])
        outside = level[nodes[some]] <= 0
        away = np.full(len(some), -OUTSIDE)
        nearest = np.zeros(len(some), dtype=np.int64)
        for side, reach in ((outside, -OUTSIDE), (~outside, np.inf)):
            away[side], nearest[side] = tree.query(at[side], distance_upper_bound=reach)
        near = np.flatnonzero(nearest < len(points))
        some, at, outside, away, nearest = some[near], at[near], outside[near], away[near], nearest[near]
        ahead = np.abs(np.einsum("ij,ij->i", at - points[nearest], normals[nearest]))
        aside = np.sqrt(np.maximum(away**2 - ahead**2, 0.0))
        flat = np.clip((_ROUND - away / lattice.spacing) / (_ROUND - _FLAT), 0.0, 1.0)
        flat[aside > _LATERAL * lattice.spacing] = 0.0
        distance = flat * ahead + (1 - flat) * away
        distances[some] = np.where(outside, np.maximum(-distance, OUTSIDE), distance)
    return distances


def _wall_points(lattice: BlockLattice, level: Field) -> tuple[Array, Array]:
    """Points (n, 3) m where edges of the lattice cross the wall, and unit normals (n, 3) there."""
    points, normals = [], []
    near = np.flatnonzero(np.abs(level) < _NEAR * lattice.spacing)
    for axis, step in enumerate(_STEPS):
        other = lattice.neighbours(near, step)
        crossing = np.flatnonzero((other >= 0) & ((level[near] > 0) != (level[other] > 0)))
        a, b = near[crossing], other[crossing]
        share = (level[a] / (level[a] - level[b])).astype(np.float64)
        place = lattice.points(lattice.nodes[a])
        place[:, axis] += share * lattice.spacing
        first_slope, second_slope = _slope(lattice, level, a), _slope(lattice, level, b)
        normal = first_slope * (1 - share[:, None]) + second_slope * share[:, None]
        points.append(place)
        normals.append(normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12))
    return np.concatenate(points), np.concatenate(normals)


def _slope(lattice: BlockLattice, level: Field, rows: Nodes) -> Array:
    """Gradient (n, 3) of a level at nodes, in units of the spacing."""
    parts = []
    for step in _STEPS:
        ahead, behind = (lattice.neighbours(rows, (s * step[0], s * step[1], s * step[2])) for s in (1, -1))
        ahead, behind = np.where(ahead < 0, rows, ahead), np.where(behind < 0, rows, behind)
        parts.append(level[ahead].astype(np.float64) - level[behind])
    return np.stack(parts, axis=1)
