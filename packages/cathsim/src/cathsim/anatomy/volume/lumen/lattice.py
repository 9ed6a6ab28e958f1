"""Nodes of a regular lattice near a lumen, in blocks, with their neighbours and distances to the wall."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.lumen import OUTSIDE
from cathsim.lattice.node_set import linked_parts

BLOCK = 8  # nodes along a block's edge

Array = NDArray[np.float64]
Nodes = NDArray[np.int64]
Field = NDArray[np.float32]

_STEPS = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
_FLAT, _ROUND = 1.0, 2.5  # spacings from the wall up to, and from which on, distances are to planes, and to points
_NEAR = 4.0  # spacings: a level further from zero than this has no neighbour on the wall's other side
_BATCH = 200_000  # nodes worked on at once
_LATERAL = 1.5  # spacings that a foot point may lie aside


@dataclass(frozen=True, eq=False)
class BlockLattice:
    """Blocks of a lattice that come near to a lumen; all other nodes are left out."""

    origin: Array  # (3,) m, node (0, 0, 0)
    spacing: float  # m
    shape: tuple[int, int, int]  # nodes of the whole lattice
    corners: Nodes  # (blocks, 3) first node of each block
    table: NDArray[np.int32]  # (bx, by, bz) block's number by place, -1 where there is none

    @classmethod
    def around(cls, points: Array, spacing: float, reach: float, padding: int) -> BlockLattice:
        """The blocks within a reach (m) of points (n, 3) m, on a lattice with so many nodes of padding about them."""
        from scipy.ndimage import distance_transform_edt

        low, high = points.min(axis=0), points.max(axis=0)
        origin = np.floor(low / spacing - padding) * spacing
        shape = np.ceil((high - origin) / spacing).astype(int) + padding + 1
        bx, by, bz = (-(-shape // BLOCK)).tolist()
        taken = np.zeros((bx, by, bz), dtype=np.bool_)
        taken[tuple((np.rint((points - origin) / spacing).astype(np.int64) // BLOCK).T)] = True
        # two points of blocks at a distance of n blocks are at least n - sqrt(3) blocks apart
        away: Array = distance_transform_edt(~taken)
        near: NDArray[np.bool_] = np.less_equal(away, reach / (BLOCK * spacing) + np.sqrt(3))
        table = np.full((bx, by, bz), -1, dtype=np.int32)
        table[np.nonzero(near)] = np.arange(np.count_nonzero(near))
        size = (int(shape[0]), int(shape[1]), int(shape[2]))
        return cls(origin, spacing, size, np.argwhere(near) * BLOCK, table)

    @cached_property
    def nodes(self) -> Nodes:
        """(n, 3) indices of all nodes, block by block."""
        within = np.stack(np.meshgrid(*[np.arange(BLOCK)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        return (self.corners[:, None, :] + within).reshape(-1, 3)

    def points(self, nodes: Nodes) -> Array:
        """Places (n, 3) m of nodes (n, 3)."""
        return self.origin + nodes * self.spacing

    def number(self, nodes: Nodes) -> Nodes:
        """Rows (n,) in `nodes` of nodes (n, 3); -1 where there is none."""
        i, j, k = (axis // BLOCK for axis in nodes.T)
        nx, ny, nz = self.table.shape
        known = np.flatnonzero((i >= 0) & (i < nx) & (j >= 0) & (j < ny) & (k >= 0) & (k < nz))
        which = np.full(len(nodes), -1, dtype=np.int64)
        which[known] = self.table[i[known], j[known], k[known]]
        a, b, c = (axis - block * BLOCK for axis, block in zip(nodes.T, (i, j, k), strict=True))
        return np.where(which >= 0, ((which * BLOCK + a) * BLOCK + b) * BLOCK + c, -1)

    def neighbours(self, rows: Nodes, step: tuple[int, int, int]) -> Nodes:
        """Rows (n,) of the nodes one step from those of rows (n,); -1 where there is none."""
        return self.number(self.nodes[rows] + np.array(step))


def neighbours(
    voxels: NDArray[np.int64], spacing: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Pairs (m, 2) of voxels that share a face, an edge or a corner, and the distances (m,) between them, m.

    Args:
        voxels: (n, 3) indices, none of them negative.
        spacing: (3,) m between voxels.
    """
    number = np.full(voxels.max(axis=0) + 3, -1, dtype=np.int64)
    number[tuple((voxels + 1).T)] = np.arange(len(voxels))
    pairs, lengths = [], []
    for step in [s for s in np.ndindex(3, 3, 3) if s > (1, 1, 1)]:  # the other half are the same pairs
        other = number[tuple((voxels + np.array(step)).T)]
        near = np.flatnonzero(other >= 0)
        pairs.append(np.stack([near, other[near]], axis=1))
        lengths.append(np.full(len(near), np.linalg.norm((np.array(step) - 1) * spacing)))
    return np.concatenate(pairs), np.concatenate(lengths)


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
