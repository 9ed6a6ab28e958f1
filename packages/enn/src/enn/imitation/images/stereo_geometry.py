"""Geometry of two calibrated views: epipolar lines, points in space, and traces of one curve matched in order."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LARGEST_FIELD = 1.0  # m
NOT_DIAGONAL = 0.002  # of the image's side: what a match costs in which one trace goes on alone


@dataclass(frozen=True, eq=False)
class StereoGeometry:
    """Two cameras about an isocentre.

    Attributes:
        projections: matrices from homogeneous places (m from the isocentre) to columns and rows as shares of the
            image's side. Shape (2, 3, 4).
        field: side of the square that the views show in the plane of the isocentre, m.
    """

    projections: Array
    field: float

    def __post_init__(self) -> None:
        """Refuses what are not two matrices, cameras with one source, and a field that is no length of an image."""
        matrices = np.asarray(self.projections, float)
        if matrices.shape != (2, 3, 4) or not np.isfinite(matrices).all():
            raise ValueError(f"projections: expected two finite matrices, shape (2, 3, 4), got {matrices.shape}")
        if not 0 < self.field <= LARGEST_FIELD:
            raise ValueError(f"field: expected a length of up to {LARGEST_FIELD:g} m, got {self.field!r}")
        first, second = (np.linalg.svd(matrix)[2][-1] for matrix in matrices)
        if abs(first @ second) > 1 - 1e-9:
            raise ValueError("projections: both cameras have one source, from which nothing is seen in space")
        object.__setattr__(self, "projections", matrices)

    @cached_property
    def fundamental(self) -> Array:
        """The fundamental matrix: second^T F first = 0 for places (column, row, 1) of one point. Shape (3, 3)."""
        first, second = self.projections
        source = np.linalg.svd(first)[2][-1]
        a, b, c = second @ source
        return np.array([[0, -c, b], [c, 0, -a], [-b, a, 0]]) @ second @ np.linalg.pinv(first)

    def triangulated(self, first: Array, second: Array) -> Array:
        """Points (n, 3) m whose images (column, row) lie nearest to the places (n, 2) in the two views."""
        rows = [
            place[:, axis, None] * matrix[2] - matrix[axis]
            for matrix, place in zip(self.projections, (first, second), strict=True)
            for axis in (0, 1)
        ]
        equations = np.stack(rows, axis=1)  # (n, 4, 4)
        left, right = equations[..., :3], equations[..., 3]
        normal = left.transpose(0, 2, 1) @ left
        return np.linalg.solve(normal, -(left.transpose(0, 2, 1) @ right[..., None]))[..., 0]

    def apart(self, first: Array, second: Array) -> Array:
        """Distances of places (m, 2) in the second view from the epipolar lines of places (n, 2) in the first, as
        shares of the image's side. Shape (n, m).
        """
        lines = np.column_stack((first, np.ones(len(first)))) @ self.fundamental.T
        lines /= np.maximum(np.hypot(lines[:, 0], lines[:, 1]), 1e-12)[:, None]
        return np.abs(lines @ np.column_stack((second, np.ones(len(second)))).T)


def matched(apart: Array) -> NDArray[np.intp]:
    """The cheapest pairs of points of two traces, in order, from the first of both to the end of one of them.

    Args:
        apart: what each pair costs. Shape (n, m).

    Returns:
        Indices into both. Shape (k, 2).
    """
    n, m = apart.shape
    alone = apart + NOT_DIAGONAL
    along = np.cumsum(alone, axis=1)
    total = np.empty((n, m))
    total[0] = along[0] - NOT_DIAGONAL
    for i in range(1, n):
        best = total[i - 1] + alone[i]
        best[1:] = np.minimum(best[1:], total[i - 1, :-1] + apart[i, 1:])
        total[i] = np.minimum.accumulate(best - along[i]) + along[i]
    ends_row, ends_column = int(np.argmin(total[-1])), int(np.argmin(total[:, -1]))
    # the end of one trace: the pair whose mean cost over its length is least
    row = total[-1, ends_row] / max(n + ends_row, 1) <= total[ends_column, -1] / max(ends_column + m, 1)
    i, j = (n - 1, ends_row) if row else (ends_column, m - 1)
    pairs = [(i, j)]
    while i or j:
        options = []
        if i and j:
            options.append((total[i - 1, j - 1], i - 1, j - 1))
        if i:
            options.append((total[i - 1, j] + NOT_DIAGONAL, i - 1, j))
        if j:
            options.append((total[i, j - 1] + NOT_DIAGONAL, i, j - 1))
        _, i, j = min(options)
        pairs.append((i, j))
    return np.array(pairs[::-1])


def projected(matrix: Array, places: Array) -> Array:
    """Columns and rows (n, 2) where a matrix (3, 4) shows places (n, 3)."""
    seen = places @ matrix[:, :3].T + matrix[:, 3]
    return seen[:, :2] / seen[:, 2:]
