"""A smooth displacement of the plane through scattered control points: local weighted mean, or a cubic B-spline.

Both take points to points. Beyond their control points they continue almost linearly, which is a guess.
"""

from __future__ import annotations

import numpy as np
from scipy import linalg
from scipy.interpolate import BSpline
from scipy.spatial import cKDTree

_SMOOTHING = 1e-3  # weight of the squared second differences of the coefficients, relative to a control point
_EVALUATED_AT_ONCE = 20_000  # points, to bound the memory


class LocalWeightedMean:
    """Quadratics through the neighbours of every control point, blended with weights that vanish at the last neighbour.

    Source: A. Goshtasby, "Image registration by local approximation methods", Image and Vision Computing 6 (1988).

    Args:
        sources: (n, 2), from where.
        targets: (n, 2), to where.
        neighbours: Control points (itself included) that a quadratic is fitted to; at least 6.

    Raises:
        ValueError: Too few control points for so many neighbours, or neighbours for a quadratic.
    """

    def __init__(self, sources: np.ndarray, targets: np.ndarray, neighbours: int = 25) -> None:
        sources, targets = _pairs(sources, targets)
        if neighbours < 6 or len(sources) < neighbours:
            raise ValueError(
                f"expected at least 6 neighbours and no fewer control points, found {neighbours} of {len(sources)}"
            )
        self.neighbours = neighbours
        self._sources = sources
        self._tree = cKDTree(sources)
        distances, around = self._tree.query(sources, k=neighbours)
        self._reach = distances[:, -1] * (1 + 1e-9)
        A = quadratic_terms((sources[around] - sources[:, None]) / self._reach[:, None, None])
        At = A.transpose(0, 2, 1)
        moves = (targets - sources)[around]
        # a trace of ridge on the bent terms, for control points whose neighbours lie on a line
        ridge = 1e-9 * neighbours * np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
        self._coefficients = np.linalg.solve(At @ A + ridge, At @ moves)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Where points (..., 2) go, (..., 2)."""
        points = np.asarray(points, float)
        flat = points.reshape(-1, 2)
        parts = [self._evaluated(flat[at : at + _EVALUATED_AT_ONCE]) for at in range(0, len(flat), _EVALUATED_AT_ONCE)]
        return np.concatenate(parts).reshape(points.shape) if parts else points.copy()

    def _evaluated(self, points: np.ndarray) -> np.ndarray:
        count = min(2 * self.neighbours, len(self._sources))
        distances, around = self._tree.query(points, k=count)
        share = np.minimum(distances / self._reach[around], 1.0)
        weight = 1 - 3 * share**2 + 2 * share**3
        total = weight.sum(axis=1)
        away = (points[:, None] - self._sources[around]) / self._reach[around][..., None]
        terms = quadratic_terms(away)
        moves = np.einsum("nkc,nkcd->nkd", terms, self._coefficients[around])
        outside = total < 1e-6
        if outside.any():  # beyond every reach: the tangent planes of the nearest control points
            weight[outside] = 0.0
            weight[outside, :6] = 1 / np.maximum(distances[outside, :6], 1e-9) ** 2
            total[outside] = weight[outside].sum(axis=1)
            tangent = self._coefficients[around[outside]][:, :, :3]
            moves[outside] = np.einsum("nkc,nkcd->nkd", terms[outside][..., :3], tangent)
        return points + np.einsum("nk,nkd->nd", weight, moves) / total[:, None]


class SplineField:
    """One cubic tensor-product B-spline of the displacement, fitted by least squares with a trace of smoothing.

    Args:
        sources: (n, 2), from where.
        targets: (n, 2), to where.
        size: (width, height) of the image that the knots are spread over.

    Raises:
        ValueError: Malformed control points.
    """

    def __init__(self, sources: np.ndarray, targets: np.ndarray, size: tuple[int, int], spans: int) -> None:
        sources, targets = _pairs(sources, targets)
        self.spans = spans
        self._low = np.array([-0.5, -0.5]) - 0.05 * np.array(size)
        self._high = np.array(size) - 0.5 + 0.05 * np.array(size)
        steps = np.arange(-3, spans + 4) / spans
        self._knots = [low + steps * (high - low) for low, high in zip(self._low, self._high, strict=True)]
        m = spans + 3
        along_x, along_y = (self._basis(sources[:, axis], axis) for axis in (0, 1))
        A = (along_y[:, :, None] * along_x[:, None, :]).reshape(len(sources), m * m)
        bends = np.diff(np.eye(m), 2, axis=0)
        bends = bends.T @ bends
        normal = A.T @ A + _SMOOTHING * (np.kron(bends, np.eye(m)) + np.kron(np.eye(m), bends))
        normal += 1e-9 * np.eye(m * m)
        self._coefficients = linalg.solve(normal, A.T @ (targets - sources), assume_a="pos").reshape(m, m, 2)

    def _basis(self, values: np.ndarray, axis: int) -> np.ndarray:
        values = np.clip(values, self._low[axis], self._high[axis])
        return BSpline.design_matrix(values, self._knots[axis], 3).toarray()

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Where points (..., 2) go, (..., 2)."""
        points = np.asarray(points, float)
        flat = points.reshape(-1, 2)
        moved = flat.copy()
        for at in range(0, len(flat), _EVALUATED_AT_ONCE):
            part = flat[at : at + _EVALUATED_AT_ONCE]
            along_x, along_y = (self._basis(part[:, axis], axis) for axis in (0, 1))
            moved[at : at + len(part)] += np.einsum(
                "ny,nx,yxd->nd", along_y, along_x, self._coefficients, optimize=True
            )
        return moved.reshape(points.shape)


def quadratic_terms(away: np.ndarray) -> np.ndarray:
    """Terms (..., 6) of a quadratic at places (..., 2): 1, x, y, x^2, x y, y^2."""
    x, y = away[..., 0], away[..., 1]
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)


def _pairs(sources: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    sources, targets = np.asarray(sources, float), np.asarray(targets, float)
    if sources.ndim != 2 or sources.shape[1:] != (2,) or sources.shape != targets.shape:
        raise ValueError(f"expected control points (n, 2) twice, found {sources.shape} and {targets.shape}")
    return sources, targets
