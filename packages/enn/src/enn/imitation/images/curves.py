"""Curves as points in order, in an image or in space: their arcs, places along them, smoothing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def at_arcs(points: Array, arc: Array, wanted: Array) -> Array:
    """Places (k, d) at the arcs `wanted` (k,) of a curve (n, d) whose points lie at the arcs `arc` (n,)."""
    return np.stack([np.interp(wanted, arc, points[:, k]) for k in range(points.shape[1])], axis=1)


def smoothed(points: Array, window: int) -> Array:
    """A curve (n, d), each point averaged with those beside it, `window` of them at most.

    Both ends are continued by reflection through them, so that they stay where they are.
    """
    half = min(window, len(points)) // 2
    if not half:
        return points
    ahead, behind = 2 * points[0] - points[half:0:-1], 2 * points[-1] - points[-2 : -half - 2 : -1]
    longer = np.concatenate((ahead, points, behind))
    kernel = np.full(2 * half + 1, 1 / (2 * half + 1))
    return np.stack([np.convolve(longer[:, k], kernel, "valid") for k in range(points.shape[1])], axis=1)
