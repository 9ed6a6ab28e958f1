"""Points on triangles, dense enough to stand for the surface, and exact distances to it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.lattice import Budget

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_BATCH = 200_000

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SurfaceSamples:
    """Points on triangles."""

    points: Array  # (n, 3) m
    face: NDArray[np.int64]  # (n,) index of the triangle each lies on
    corners: Array  # (m, 3, 3) m, all triangles

    @cached_property
    def bounds(self) -> Array:
        """Lowest and highest place (2, 3) m of the points."""
        return bounds_of(self.points)

    @cached_property
    def tree(self) -> cKDTree:
        """Search tree over the points."""
        from scipy.spatial import cKDTree

        return cKDTree(self.points, balanced_tree=False, compact_nodes=False)

    @cached_property
    def normals(self) -> Array:
        """Unit normals (m, 3) of the triangles, to either side; zero for a triangle without area."""
        a, b, c = self.corners.transpose(1, 0, 2)
        normal = np.cross(b - a, c - a)
        return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)

    def select(self, keep: NDArray[np.bool_]) -> SurfaceSamples:
        """Some of the points, by a mask (n,), of the same triangles."""
        return SurfaceSamples(self.points[keep], self.face[keep], self.corners)

    def nearest(self, points: Array, neighbours: int = 6) -> tuple[Array, Array, NDArray[np.int64]]:
        """Nearest places on the triangles that the nearest samples belong to.

        Args:
            points: (k, 3) m.
            neighbours: how many samples' triangles are tried.

        Returns:
            Distances (k,) m, nearest places (k, 3) m, and their triangles (k,).
        """
        distance, place = np.full(len(points), np.inf), np.zeros((len(points), 3))
        face = np.zeros(len(points), dtype=np.int64)
        neighbours = min(neighbours, len(self.points))
        for start in range(0, len(points), _BATCH):
            part = slice(start, start + _BATCH)
            some = points[part]
            _, near = self.tree.query(some, neighbours)
            facing = np.zeros(len(some))
            for candidate in self.face[near.reshape(len(some), -1)].T:
                foot = nearest_on_triangles(some, self.corners[candidate])
                away = np.linalg.norm(some - foot, axis=1)
                ahead = np.abs(np.einsum("ij,ij->i", some - foot, self.normals[candidate]))
                # At an edge two triangles are equally near: the one that faces the point decides the side.
                better = (away < distance[part] - 1e-9) | ((away < distance[part] + 1e-9) & (ahead > facing))
                distance[part][better], place[part][better] = away[better], foot[better]
                face[part][better], facing[better] = candidate[better], ahead[better]
        return distance, place, face


def bounds_of(points: Array) -> Array:
    """Lowest and highest corner (2, 3) of a box about points (n, 3)."""
    return np.array([(axis.min(), axis.max()) for axis in points.T]).T  # several times as fast as along the first axis


def sample_surface(corners: Array, spacing: float, budget: Budget | None = None) -> SurfaceSamples:
    """Points on triangles (m, 3, 3) m at a distance of at most `spacing` (m) along their edges.

    Raises:
        MeshRefusedError: there would be more points than the budget allows.
    """
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    ratio = np.maximum(np.ceil(edges / spacing), 1.0)
    (budget or Budget()).check_samples(float(((ratio + 1) * (ratio + 2) / 2).sum()))
    parts = ratio.astype(np.int64)
    points, face = [], []
    for count in np.unique(parts):
        facets = np.flatnonzero(parts == count)
        i, j = np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij")
        within = i + j <= count
        weights = np.stack([count - i - j, i, j], axis=-1)[within] / count
        for some in np.array_split(facets, max(1, len(facets) * len(weights) // 2_000_000)):
            made = np.empty((len(some), len(weights), 3))
            for axis, (a, b, c) in enumerate(corners[some].T[..., None]):
                made[..., axis] = a * weights[:, 0] + b * weights[:, 1] + c * weights[:, 2]
            points.append(made.reshape(-1, 3))
            face.append(np.repeat(some, len(weights)))
    return SurfaceSamples(np.concatenate(points), np.concatenate(face), corners)


def nearest_on_triangles(points: Array, corners: Array) -> Array:
    """Nearest place (k, 3) m on a triangle (k, 3, 3) m each to points (k, 3) m."""
    a, b, c = corners.transpose(1, 0, 2)
    ab, ac, ap = b - a, c - a, points - a
    d00, d01, d11 = (np.einsum("ij,ij->i", x, y) for x, y in ((ab, ab), (ab, ac), (ac, ac)))
    d20, d21 = np.einsum("ij,ij->i", ap, ab), np.einsum("ij,ij->i", ap, ac)
    area = d00 * d11 - d01 * d01
    safe = np.where(area > 1e-30, area, 1.0)
    v, w = (d11 * d20 - d01 * d21) / safe, (d00 * d21 - d01 * d20) / safe
    inside = (area > 1e-30) & (v >= 0) & (w >= 0) & (v + w <= 1)
    best = a + v[:, None] * ab + w[:, None] * ac
    distance = np.where(inside, 0.0, np.inf)
    for start, along in ((a, ab), (a, ac), (b, c - b)):
        square = np.maximum(np.einsum("ij,ij->i", along, along), 1e-30)
        fraction = np.clip(np.einsum("ij,ij->i", points - start, along) / square, 0.0, 1.0)
        foot = start + fraction[:, None] * along
        away = np.linalg.norm(points - foot, axis=1)
        better = away < distance
        best[better], distance[better] = foot[better], away[better]
    return best
