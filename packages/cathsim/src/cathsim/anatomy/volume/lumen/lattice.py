"""Nodes of a regular lattice near a lumen, in blocks, with their neighbours."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

BLOCK = 8  # nodes along a block's edge

Array = NDArray[np.float64]
Nodes = NDArray[np.int64]


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
