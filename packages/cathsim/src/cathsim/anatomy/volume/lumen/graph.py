"""Ways along a lumen's middle, on the nodes of a lattice of blocks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.volume.lumen.lattice import BlockLattice, Nodes

_COARSE = 9e-4  # m: on a finer lattice every second node is left out

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LumenGraph:
    """A lumen's nodes with their neighbours."""

    points: Array  # (n, 3) m
    depth: Array  # (n,) m, distance to the wall
    rows: Nodes  # (n,) of the lattice
    pairs: Nodes  # (m, 2) neighbours
    lengths: Array  # (m,) m between them
    spacing: float  # m

    @classmethod
    def of(cls, lattice: BlockLattice, depth: NDArray[np.float32], inside: NDArray[np.bool_]) -> LumenGraph:
        """The graph of a lumen's nodes.

        Args:
            depth: (n,) m, distance of all nodes to the wall.
            inside: (n,) which nodes belong to the lumen.
        """
        step = 2 if lattice.spacing < _COARSE else 1
        rows = np.flatnonzero(inside)
        if step > 1:
            rows = rows[(lattice.nodes[rows] % step == 0).all(axis=1)]
        place = np.full(len(depth) + 1, -1, dtype=np.int64)
        place[rows] = np.arange(len(rows))
        pairs, lengths = [], []
        steps = [tuple(int(n) - 1 for n in s) for s in np.ndindex(3, 3, 3)]
        for way in [s for s in steps if s > (0, 0, 0)]:
            other = place[lattice.neighbours(rows, (step * way[0], step * way[1], step * way[2]))]
            linked = np.flatnonzero(other >= 0)
            pairs.append(np.stack([linked, other[linked]], axis=1))
            lengths.append(np.full(len(linked), np.linalg.norm(way) * step * lattice.spacing))
        points = lattice.points(lattice.nodes[rows])
        return cls(
            points, depth[rows].astype(np.float64), rows, np.concatenate(pairs), np.concatenate(lengths),
            step * lattice.spacing,
        )  # fmt: skip

    @cached_property
    def _middle_cost(self) -> Array:
        """(m,) cost of every pair: its length, dearer near the wall, so that ways keep to the middle."""
        dear = (self.spacing / np.maximum(self.depth, 0.5 * self.spacing)) ** 2
        return self.lengths * 0.5 * (dear[self.pairs[:, 0]] + dear[self.pairs[:, 1]])

    def away(self, start: int, mask: NDArray[np.bool_] | None = None) -> Array:
        """Distance (n,) m within the lumen, or within some of its nodes; infinite where there is no way."""
        return self._search(start, self.lengths, mask)[0]

    def ways(self, start: int, ends: list[int]) -> list[Nodes]:
        """Ways (k,) of nodes along the middle from a start to ends, shared until they part."""
        _, before = self._search(start, self._middle_cost, None)
        ways = []
        for end in ends:
            way = [end]
            while way[-1] != start:
                way.append(int(before[way[-1]]))
                if way[-1] < 0:
                    raise ValueError(f"no way leads to node {end}")
            ways.append(np.array(way[::-1]))
        return ways

    def way(self, start: int, end: int, mask: NDArray[np.bool_]) -> Nodes:
        """The way (k,) of nodes along the middle between two, within some nodes where there is one.

        Raises:
            MeshRefusedError: no way leads there.
        """
        for allowed in (mask, None):
            _, before = self._search(start, self._middle_cost, allowed)
            way = [end]
            while way[-1] != start and before[way[-1]] >= 0:
                way.append(int(before[way[-1]]))
            if way[-1] == start:
                return np.array(way[::-1])
        raise MeshRefusedError("the lumen falls apart between two places of one vessel; take a finer resolution.")

    def _search(self, start: int, cost: Array, mask: NDArray[np.bool_] | None) -> tuple[Array, Nodes]:
        from scipy.sparse import csr_matrix
        from scipy.sparse.csgraph import dijkstra

        first, second = self.pairs.T
        if mask is not None:
            inside = mask[first] & mask[second]
            first, second, cost = first[inside], second[inside], cost[inside]
        graph = csr_matrix((cost, (first, second)), shape=(len(self.points),) * 2)
        away, before = dijkstra(graph, directed=False, indices=start, return_predecessors=True)
        return away, before.astype(np.int64)

    def nearest(self, place: Array, mask: NDArray[np.bool_] | None = None) -> int:
        """The node nearest to a place (3,) m, among some."""
        numbers = np.arange(len(self.points)) if mask is None else np.flatnonzero(mask)
        return int(numbers[np.argmin(((self.points[numbers] - place) ** 2).sum(axis=1))])
