"""A smooth displacement of the plane through scattered control points, by a local weighted mean.

It takes points to points. Beyond its control points it continues almost linearly, which is a guess.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

NEIGHBOURS = 25  # control points, itself included, that a quadratic is fitted to
_EVALUATED_AT_ONCE = 20_000  # points, to bound the memory


class LocalWeightedMean:
    """Quadratics through the neighbours of every control point, blended with weights that vanish at the last neighbour.

    Source: A. Goshtasby, "Image registration by local approximation methods", Image and Vision Computing 6 (1988).

    Args:
        sources: (n, 2), from where.
        targets: (n, 2), to where.

    Raises:
        ValueError: Malformed or too few control points.
    """

    def __init__(self, sources: np.ndarray, targets: np.ndarray) -> None:
        sources, targets = np.asarray(sources, float), np.asarray(targets, float)
        if sources.ndim != 2 or sources.shape[1:] != (2,) or sources.shape != targets.shape:
            raise ValueError(f"expected control points (n, 2) twice, found {sources.shape} and {targets.shape}")
        if len(sources) < NEIGHBOURS:
            raise ValueError(f"expected at least {NEIGHBOURS} control points, found {len(sources)}")
        self._sources = sources
        self._tree = cKDTree(sources)
        distances, around = self._tree.query(sources, k=NEIGHBOURS)
        self._reach = distances[:, -1] * (1 + 1e-9)
        A = quadratic_terms((sources[around] - sources[:, None]) / self._reach[:, None, None])
        At = A.transpose(0, 2, 1)
        moves = (targets - sources)[around]
        # a trace of ridge on the bent terms, for control points whose neighbours lie on a line
        ridge = 1e-9 * NEIGHBOURS * np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
        self._coefficients = np.linalg.solve(At @ A + ridge, At @ moves)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Where points (..., 2) go, (..., 2)."""
        points = np.asarray(points, float)
        flat = points.reshape(-1, 2)
        parts = [self._evaluated(flat[at : at + _EVALUATED_AT_ONCE]) for at in range(0, len(flat), _EVALUATED_AT_ONCE)]
        return np.concatenate(parts).reshape(points.shape) if parts else points.copy()

    def _evaluated(self, points: np.ndarray) -> np.ndarray:
        count = min(2 * NEIGHBOURS, len(self._sources))
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


def quadratic_terms(away: np.ndarray) -> np.ndarray:
    """Terms (..., 6) of a quadratic at places (..., 2): 1, x, y, x^2, x y, y^2."""
    x, y = away[..., 0], away[..., 1]
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
