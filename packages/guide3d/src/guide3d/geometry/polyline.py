"""Polylines: checked arrays of points along a curve, their arc length, their resampling, and distances from them.

A polyline is an (n, d) array, tip first, in pixels (d = 2) or millimetres (d = 3).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]

_FINE = 1000  # vertices at least, for `distances_to`


def checked(points: ArrayLike, dimension: int | None = None, what: str = "polyline") -> Array:
    """Returns the points of a polyline as a float array, or says what is wrong with them.

    Args:
        points: (n, d) points, tip first.
        dimension: d that is expected, any where None.
        what: the polyline's name in messages, such as "annotation of camera A".

    Returns:
        (m, d) points without repeated neighbours.

    Raises:
        ValueError: not (n, d), not finite, or fewer than two different points.
    """
    array = np.asarray(points, dtype=float)
    expected = f"(n, {'d' if dimension is None else dimension})"
    if array.ndim != 2 or (dimension is not None and array.shape[1] != dimension):
        raise ValueError(f"{what}: expected points of shape {expected}, got {array.shape}; give one point a row")
    if not np.isfinite(array).all():
        bad = int(np.flatnonzero(~np.isfinite(array).all(axis=1))[0])
        raise ValueError(f"{what}: point {bad} is not finite; drop it before going on")
    vertices = array[np.concatenate([[True], (np.diff(array, axis=0) != 0).any(axis=1)])] if len(array) else array
    if len(vertices) < 2:
        raise ValueError(
            f"{what}: expected at least 2 different points, got {len(vertices)}; no curve goes through that"
        )
    return vertices


def arc_length(points: ArrayLike) -> Array:
    """Returns the length (n,) of a polyline (n, d) up to each of its points, in their unit, from 0."""
    array = np.asarray(points, dtype=float)
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(array, axis=0), axis=1))])


def at_length(points: ArrayLike, lengths: ArrayLike) -> Array:
    """Returns the points (m, d) at lengths (m,) along a polyline (n, d); lengths beyond an end give that end."""
    array = np.asarray(points, dtype=float)
    along = arc_length(array)
    positions = np.asarray(lengths, dtype=float)
    return np.stack([np.interp(positions, along, column) for column in array.T], axis=-1)


def resample(points: ArrayLike, spacing: float | None = None, count: int | None = None) -> Array:
    """Resamples a polyline at equal arc length.

    Args:
        spacing: distance of the new points; the last one lies less than this before the end, which is left out.
        count: number of new points, both ends among them; give this or `spacing`.

    Returns:
        (m, d) points, the first of them the first of `points`.

    Raises:
        ValueError: neither or both of spacing and count, or values that make no polyline.
    """
    if (spacing is None) == (count is None):
        raise ValueError("resample: expected either spacing or count")
    array = checked(points)
    length = arc_length(array)[-1]
    if spacing is not None:
        if not spacing > 0:
            raise ValueError(f"resample: expected a spacing above 0, got {spacing}")
        # a hair more, so that a length of exactly n spacings keeps its last point
        lengths = spacing * np.arange(int(length / spacing + 1e-9) + 1)
    else:
        if count is None or count < 2:
            raise ValueError(f"resample: expected a count of at least 2, got {count}")
        lengths = np.linspace(0.0, length, count)
    return at_length(array, lengths)


def thinned(points: ArrayLike, closest: float) -> Array:
    """Drops points (n, d) that lie closer than a distance, in their unit, to the last point kept; both ends stay."""
    array = np.asarray(points, dtype=float)
    numbers, rows = [0], array.tolist()  # numpy takes ten times as long, point by point
    last = rows[0]
    for i, row in enumerate(rows[1:], 1):
        if math.dist(row, last) >= closest:
            numbers.append(i)
            last = row
    if numbers[-1] != len(array) - 1:
        if len(numbers) > 1:
            numbers[-1] = len(array) - 1
        else:
            numbers.append(len(array) - 1)
    return array[numbers]


def distances_to(polyline: ArrayLike, points: ArrayLike) -> Array:
    """Returns the distances (m,) of points (m, d) from a polyline (n, d)."""
    line, places = np.asarray(polyline, dtype=float), np.asarray(points, dtype=float)
    # the nearest vertex belongs to the nearest segment only where vertices are dense
    along = arc_length(line)
    line = at_length(line, np.union1d(along, np.linspace(0.0, along[-1], _FINE)))
    near = np.atleast_1d(cKDTree(line).query(places)[1])
    best = np.full(len(places), np.inf)
    for first in (np.clip(near - 1, 0, len(line) - 2), np.clip(near, 0, len(line) - 2)):
        start, step = line[first], line[first + 1] - line[first]
        share = np.clip(((places - start) * step).sum(1) / np.maximum((step * step).sum(1), 1e-300), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(places - start - share[:, None] * step, axis=1))
    return best
