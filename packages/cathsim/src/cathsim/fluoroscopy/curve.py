"""The smooth curve through a wire's nodes, sampled as finely as an image asks for, and cuts of a polyline."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

ROUND_END = np.pi / 4  # of the radius: a flat end's strip that has the area of the half disc that is drawn instead


def smooth_curve(nodes: ArrayLike, spacing: float) -> tuple[Array, Array]:
    """Samples the curve whose slope at every node is that of the parabola through it and its neighbours.

    Args:
        nodes: (n, 3) m, in order; repeated ones count once.
        spacing: m, largest distance between samples along the chords.

    Returns:
        (m, 3) m, the samples, the nodes among them; and (m,) m, the arc length to each from the first.

    Raises:
        ValueError: for another shape, nodes that are not finite, or a spacing that is not positive.
    """
    points = np.asarray(nodes, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"the wire's nodes must have shape (n, 3), got {points.shape}.")
    if not np.isfinite(points).all():
        raise ValueError("a coordinate of the wire is not finite; the simulation has diverged, reset it.")
    if not spacing > 0:
        raise ValueError(f"the spacing of a curve's samples must be positive, got {spacing!r} m.")
    if len(points) > 1:
        points = points[np.r_[True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-9]]
    if len(points) < 2:
        return points.copy(), np.zeros(len(points))
    steps = np.diff(points, axis=0)
    h = np.linalg.norm(steps, axis=1)
    chords = steps / h[:, None]
    slopes = np.empty_like(points)
    if len(points) == 2:
        slopes[:] = chords[0]
    else:
        before, after = h[:-1, None], h[1:, None]
        slopes[1:-1] = (after * chords[:-1] + before * chords[1:]) / (before + after)
        slopes[0] = 2 * chords[0] - slopes[1]
        slopes[-1] = 2 * chords[-1] - slopes[-2]
    pieces = np.maximum(np.ceil(h / spacing).astype(int), 1)
    link = np.repeat(np.arange(len(h)), pieces)
    t = (np.arange(len(link)) - np.repeat(np.cumsum(pieces) - pieces, pieces)) / pieces[link]
    t, s, scale = t[:, None], 1 - t[:, None], h[link, None]
    a, b, slope_a, slope_b = points[link], points[link + 1], slopes[link], slopes[link + 1]
    samples = (
        s * s * (1 + 2 * t) * a + t * t * (1 + 2 * s) * b + scale * t * s * s * slope_a - scale * s * t * t * slope_b
    )
    samples = np.concatenate((samples, points[-1:]))
    lengths = np.linalg.norm(np.diff(samples, axis=0), axis=1)
    return samples, np.concatenate(([0.0], np.cumsum(lengths)))


def split(nodes: Array, distance: float) -> tuple[Array, Array]:
    """A polyline (n, 3) m cut at a distance from its first node, m, greater than 0.

    Returns:
        The part before and the part behind, which is empty where the polyline ends before; both have the node at the
        cut.
    """
    left = distance
    for index in range(len(nodes) - 1):
        step = math.dist(nodes[index], nodes[index + 1])
        if step == left:
            return nodes[: index + 2], nodes[index + 1 :]
        if not step < left:  # also what is not finite, so that drawing refuses it
            cut = nodes[index : index + 1] + left / step * (nodes[index + 1] - nodes[index])
            return np.concatenate((nodes[: index + 1], cut)), np.concatenate((cut, nodes[index + 1 :]))
        left -= step
    return nodes, nodes[:0]
