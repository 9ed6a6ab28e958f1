"""Visual hull of a vessel in two views, and the way through it to a target.

The hull holds the voxels that both views show as lumen. Where two vessels overlap in a view it holds more than the
vessels, so a way is sought where it keeps away from the hull's border: what is there by chance is thin.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from enn.imitation.images.stereo_geometry import StereoGeometry, projected

Array = NDArray[np.float64]

VOXEL = 2.5e-3  # m
MARGIN = 1.15  # side of the cube of voxels over that of the field
CENTRING = 300.0  # a step k mm from the hull's border costs 1 + so much over the square of k
RAY_STEP, RAY_SAMPLES = 1.5e-3, 20
_STEPS = np.array([(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if (i, j, k) > (0, 0, 0)])


@dataclass(frozen=True, eq=False)
class SeenVoxels:
    """The voxels of a cube about the isocentre and where two cameras see them; made once, for all hulls."""

    geometry: StereoGeometry

    @cached_property
    def side(self) -> int:
        """Voxels along a side of the cube."""
        return int(np.ceil(MARGIN * self.geometry.field / VOXEL))

    @cached_property
    def seen(self) -> tuple[Array, NDArray[np.bool_]]:
        """Where the views see each voxel's middle, column and row, shape (2, n^3, 2), and whether both do, (n^3,)."""
        axis = (np.arange(self.side) - (self.side - 1) / 2) * VOXEL
        middles = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
        places = np.stack([projected(matrix, middles) for matrix in self.geometry.projections])
        return places, np.all((places > 0) & (places < 1), axis=(0, 2))

    def voxel(self, places: Array) -> Array:
        """Indices, not whole, of places (..., 3) m. Shape (..., 3)."""
        return places / VOXEL + (self.side - 1) / 2

    def place(self, voxels: ArrayLike) -> Array:
        """Middles (..., 3) m of voxels (..., 3)."""
        return (np.asarray(voxels, float) - (self.side - 1) / 2) * VOXEL


class VisualHull:
    """The hull of a vessel and the ways through it to a target.

    Args:
        voxels: of the cameras.
        lumens: probability of the vessel's lumen in both views. Each of shape (size, size).
        target: m from the isocentre. Shape (3,).
    """

    def __init__(self, voxels: SeenVoxels, lumens: list[Array], target: Array) -> None:
        self.voxels, self.target = voxels, target
        self.inside = self._hull_of(lumens)
        if not self.inside.any():
            self.inside[tuple(self._clipped(target))] = True
        depth = ndimage.distance_transform_edt(self.inside) * VOXEL * 1e3
        self._nearest = ndimage.distance_transform_edt(~self.inside, return_distances=False, return_indices=True)
        self._indices = np.argwhere(self.inside)
        self._numbers = np.full(self.inside.shape, -1)
        self._numbers[tuple(self._indices.T)] = np.arange(len(self._indices))
        self._following = self._ways(depth)

    def _hull_of(self, lumens: list[Array]) -> NDArray[np.bool_]:
        places, seen = self.voxels.seen
        hull = seen.copy()
        for lumen, place in zip(lumens, places, strict=True):
            size = len(lumen)
            at = np.clip(np.rint(place * size - 0.5).astype(int), 0, size - 1)
            hull &= np.asarray(lumen)[at[:, 1], at[:, 0]] > 0.5
        return hull.reshape((self.voxels.side,) * 3)

    def _clipped(self, place: Array) -> NDArray[np.intp]:
        return np.clip(np.rint(self.voxels.voxel(place)).astype(int), 0, self.voxels.side - 1)

    def _inner(self, place: Array) -> int:
        """Number of the hull's voxel nearest to a place."""
        return int(self._numbers[tuple(self._nearest[:, *self._clipped(place)])])

    def _ways(self, depth: Array) -> NDArray[np.intp]:
        """For each voxel of the hull the next one on its way to the target, negative at the end."""
        inside, side = self._indices, self.voxels.side
        cost = 1.0 + CENTRING / np.maximum(depth[tuple(inside.T)], 0.5) ** 2
        rows, columns, prices = [], [], []
        for step in _STEPS:
            neighbours = inside + step
            ok = np.flatnonzero(((neighbours >= 0) & (neighbours < side)).all(axis=1))
            other = self._numbers[tuple(neighbours[ok].T)]
            ok, other = ok[other >= 0], other[other >= 0]
            rows.append(ok)
            columns.append(other)
            prices.append(0.5 * (cost[ok] + cost[other]) * np.linalg.norm(step))
        every = (np.concatenate(rows), np.concatenate(columns))
        graph = csr_matrix((np.concatenate(prices), every), shape=(len(inside),) * 2)
        end = self._inner(self.target)
        return np.asarray(dijkstra(graph, directed=False, indices=end, return_predecessors=True)[1])

    def way(self, start: Array) -> tuple[Array, float]:
        """The way from a place (3,) m: its points from there on, (n, 3) m, and its length, m."""
        nodes = [self._inner(start)]
        while self._following[nodes[-1]] >= 0:
            nodes.append(int(self._following[nodes[-1]]))
        points = self.voxels.place(self._indices[nodes])
        points[0] = start
        points[-1] = self.target if len(nodes) > 1 else start
        if len(nodes) == 1:
            points = np.stack((start, self.target))
        for _ in range(2):
            if len(points) > 2:
                points[1:-1] = 0.25 * points[:-2] + 0.5 * points[1:-1] + 0.25 * points[2:]
        return points, float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())

    def walls(self, start: Array, directions: Array) -> Array:
        """Distances (n,) m from a place (3,) m to the hull's border along directions (n, 3), 30 mm at most."""
        reach = np.arange(1, RAY_SAMPLES + 1) * RAY_STEP
        places = start + directions[:, None] * reach[:, None]
        at = np.clip(np.rint(self.voxels.voxel(places)).astype(int), 0, self.voxels.side - 1)
        return np.minimum.accumulate(self.inside[tuple(np.moveaxis(at, -1, 0))], axis=1).sum(axis=1) * RAY_STEP
