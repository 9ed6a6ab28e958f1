"""Distances between two curves in space, tip first: MaxED, METE, MERS, Fréchet and Chamfer, in millimetres.

With a(s), b(s) the points at arc length s from the tips and s = 0, h, 2h, ... up to the shorter length:

    MaxED = max_s |a(s) - b(s)|        largest distance at equal arc length
    METE  = |a(0) - b(0)|              distance of the tips
    MERS  = mean_s |a(s) - b(s)|       mean distance at equal arc length

A curve ends where it leaves an image, so the longer one's rest is not compared by these three. It is by the other two,
which take both curves in full, resampled at h:

    Fréchet = min over monotone walks along both of the largest distance on the walk (discrete Fréchet distance)
    Chamfer = (mean_i min_j |a_i - b_j| + mean_j min_i |a_i - b_j|) / 2
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.distance import cdist

from guide3d.geometry.polyline import Array, arc_length, at_length, checked, resample

SPACING_MM = 1.0


def distances_along(a_mm: ArrayLike, b_mm: ArrayLike, spacing_mm: float = SPACING_MM) -> Array:
    """Returns the distances of two curves at equal arc length from their tips.

    Args:
        a_mm, b_mm: (n, 3) and (m, 3) points, tip first.
        spacing_mm: step of the arc length.

    Returns:
        (k,) distances in mm at 0, spacing, 2 spacing, ... up to the shorter length.

    Raises:
        ValueError: a curve of fewer than two different points, or a spacing that is not above 0.
    """
    a, b = checked(a_mm, 3, "curve a"), checked(b_mm, 3, "curve b")
    if not spacing_mm > 0:
        raise ValueError(f"spacing_mm: expected above 0, got {spacing_mm}")
    length = min(arc_length(a)[-1], arc_length(b)[-1])
    along = spacing_mm * np.arange(int(length / spacing_mm + 1e-9) + 1)
    return np.linalg.norm(at_length(a, along) - at_length(b, along), axis=1)


def max_ed(a_mm: ArrayLike, b_mm: ArrayLike, spacing_mm: float = SPACING_MM) -> float:
    """Returns MaxED, the largest distance (mm) of two (n, 3) curves at equal arc length from the tip."""
    return float(distances_along(a_mm, b_mm, spacing_mm).max())


def mete(a_mm: ArrayLike, b_mm: ArrayLike) -> float:
    """Returns METE, the distance (mm) of the tips of two (n, 3) curves."""
    return float(np.linalg.norm(checked(a_mm, 3, "curve a")[0] - checked(b_mm, 3, "curve b")[0]))


def mers(a_mm: ArrayLike, b_mm: ArrayLike, spacing_mm: float = SPACING_MM) -> float:
    """Returns MERS, the mean distance (mm) of two (n, 3) curves at equal arc length from the tip."""
    return float(distances_along(a_mm, b_mm, spacing_mm).mean())


def frechet(a_mm: ArrayLike, b_mm: ArrayLike, spacing_mm: float = SPACING_MM) -> float:
    """Returns the discrete Fréchet distance (mm) of two (n, 3) curves resampled at `spacing_mm`.

    Source:
        Eiter and Mannila, Computing Discrete Fréchet Distance (1994), as a dynamic programme.
    """
    distance = cdist(_whole(a_mm, spacing_mm, "curve a"), _whole(b_mm, spacing_mm, "curve b"))
    n, m = distance.shape
    # anti-diagonals: their cells depend only on the two before; held by row i, padded by one
    before = np.full(n + 1, np.inf)
    last = np.full(n + 1, np.inf)
    for k in range(n + m - 1):
        rows = np.arange(max(0, k - m + 1), min(n, k + 1))
        reach = np.minimum(np.minimum(last[rows], last[rows + 1]), before[rows])
        if k == 0:
            reach[:] = 0.0
        now = np.full(n + 1, np.inf)
        now[rows + 1] = np.maximum(reach, distance[rows, k - rows])
        before, last = last, now
    return float(last[n])


def chamfer(a_mm: ArrayLike, b_mm: ArrayLike, spacing_mm: float = SPACING_MM) -> float:
    """Returns the Chamfer distance (mm) of two (n, 3) curves: the mean of both directed mean distances."""
    distance = cdist(_whole(a_mm, spacing_mm, "curve a"), _whole(b_mm, spacing_mm, "curve b"))
    return float((distance.min(axis=1).mean() + distance.min(axis=0).mean()) / 2)


def curve_metrics(a_mm: ArrayLike, b_mm: ArrayLike, spacing_mm: float = SPACING_MM) -> dict[str, float]:
    """Returns all five distances of two (n, 3) curves by name: max_ed, mete, mers, frechet and chamfer, in mm."""
    along = distances_along(a_mm, b_mm, spacing_mm)
    return {
        "max_ed": float(along.max()),
        "mete": float(along[0]),
        "mers": float(along.mean()),
        "frechet": frechet(a_mm, b_mm, spacing_mm),
        "chamfer": chamfer(a_mm, b_mm, spacing_mm),
    }


def _whole(points_mm: ArrayLike, spacing_mm: float, what: str) -> Array:
    points = checked(points_mm, 3, what)
    sampled = resample(points, spacing=spacing_mm)
    # the end belongs to the curve, too
    return sampled if np.allclose(sampled[-1], points[-1]) else np.vstack([sampled, points[-1]])
