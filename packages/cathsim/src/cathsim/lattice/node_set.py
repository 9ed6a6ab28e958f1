"""Some nodes of a lattice, numbered, so that neighbours are found and arrays need not span the lattice."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cathsim.lattice.node_blocks import STRIDES, NodeBlocks

_BATCH = 2**20  # nodes handled at once, so that memory stays bounded
FACES = ((-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1))  # to the 6 neighbours across a face


@dataclass(frozen=True, eq=False)
class NodeSet:
    """The nodes of a lattice whose values fulfil a condition, numbered from 0 in C order."""

    indices: NDArray[np.int32]  # (n, 3)
    values: NDArray  # (n,)
    numbers: NodeBlocks  # number of each of these nodes, int32, -1 at all others
    positions: NDArray[np.int64]  # (n,) where each stands in `numbers.nodes` as a flat array

    @classmethod
    def where(cls, blocks: NodeBlocks, condition: Callable[[NDArray], NDArray[np.bool_]]) -> NodeSet:
        """The nodes at which a condition on arrays of values holds."""
        indices, values = blocks.where(condition)
        numbers = NodeBlocks.from_nodes(indices, np.arange(len(indices), dtype=np.int32), blocks.shape, -1)
        positions = np.empty(len(indices), dtype=np.int64)
        for first in range(0, len(indices), _BATCH):
            batch = slice(first, first + _BATCH)
            positions[batch] = numbers.positions(indices[batch])
        return cls(indices, values, numbers, positions)

    def __len__(self) -> int:
        return len(self.indices)

    def neighbours(self, rows: NDArray[np.integer] | slice, step: Sequence[int]) -> NDArray[np.int32]:
        """Numbers (m,) of the neighbours of chosen nodes (m,), -1 where that is none of the set.

        Args:
            step: -1, 0 or 1 along each axis.
        """
        return self.numbers.nodes.reshape(-1)[self.positions[rows] + int(np.dot(step, STRIDES))]

    def number_at(self, index: NDArray[np.integer]) -> int:
        """Number of the node at an index (3,) of the lattice, -1 where that is none of the set."""
        return int(self.numbers.nodes.reshape(-1)[self.numbers.positions(index)])

    def spread(self, values: NDArray, constant: float) -> NodeBlocks:
        """A lattice with these values (n,) at the nodes and a constant at all others."""
        extended = np.append(values, values.dtype.type(constant))  # to which -1 points
        return NodeBlocks(self.numbers.shape, self.numbers.table, extended[self.numbers.nodes])

    def parts(self) -> NDArray[np.int32]:
        """Number (n,) of the part that each node belongs to; nodes of a part hang together across faces."""
        ends = []
        for step in FACES[1::2]:
            after = self.neighbours(slice(None), step)
            first = np.flatnonzero(after >= 0).astype(np.int32)
            ends.append((first, after[first]))
        first, second = (np.concatenate(half) for half in zip(*ends, strict=True))
        return linked_parts(first, second, len(self))


class NodeSetStruct(ctypes.Structure):
    """Some nodes of a lattice (struct NodeSet of lattice.h)."""

    _fields_ = (("count", ctypes.c_int32), ("numbers", ctypes.c_void_p), ("positions", ctypes.c_void_p))

    @classmethod
    def of(cls, nodes: NodeSet) -> NodeSetStruct:
        """The struct of a set, which must outlive its use."""
        return cls(len(nodes), nodes.numbers.nodes.ctypes.data, nodes.positions.ctypes.data)


def linked_parts(first: NDArray[np.integer], second: NDArray[np.integer], count: int) -> NDArray[np.int32]:
    """Number (count,) of the part that each of so many things belongs to, from 0 on.

    Args:
        first, second: numbers (m,) of the things that are linked to each other.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    links = coo_matrix((np.ones(len(first), dtype=np.int8), (first, second)), shape=(count, count))
    return np.asarray(connected_components(links, directed=False)[1], dtype=np.int32)
