"""Masks of a wire: the strip of pixels around an annotated polyline."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from guide3d.geometry.polyline import checked

_PIECE_PX = 32.0  # longer pieces are cut, so that the window around each stays small


def strip_mask(points: ArrayLike, width: int, height: int, width_px: float = 6.0) -> NDArray[np.uint8]:
    """The mask of a wire along a polyline (n, 2) px, with round ends: (height, width) uint8, 255 on the wire, else 0.

    A pixel belongs to the mask where the strip covers half of it, which is where its centre lies within half the width
    of the polyline: the threshold at 128 of an anti-aliased drawing.

    Raises:
        ValueError: points that are no polyline, or a width that is not above 0.
    """
    if not width_px > 0:
        raise ValueError(f"width_px: expected above 0, got {width_px}")
    line = checked(points, 2)
    reach = max(width_px / 2, 0.5)  # a thinner strip would have gaps
    near = np.zeros((height, width), bool)
    starts, ends = _cut(line)
    low = np.floor(np.minimum(starts, ends) - reach).astype(int)
    high = np.ceil(np.maximum(starts, ends) + reach).astype(int)
    low, high = np.maximum(low, 0), np.minimum(high, [width - 1, height - 1])
    for start, end, (left, top), (right, bottom) in zip(starts, ends, low, high, strict=True):
        if left > right or top > bottom:
            continue
        x = np.arange(left, right + 1) - start[0]
        y = np.arange(top, bottom + 1)[:, None] - start[1]
        step = end - start
        along = np.clip((x * step[0] + y * step[1]) / max(float(step @ step), 1e-12), 0.0, 1.0)
        distance2 = np.square(x - along * step[0]) + np.square(y - along * step[1])
        near[top : bottom + 1, left : right + 1] |= distance2 <= reach * reach
    return np.where(near, 255, 0).astype(np.uint8)


def _cut(line: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Starts and ends of pieces of at most `_PIECE_PX`."""
    steps = np.diff(line, axis=0)
    pieces = np.maximum(np.ceil(np.linalg.norm(steps, axis=1) / _PIECE_PX).astype(int), 1)
    segment = np.repeat(np.arange(len(steps)), pieces)
    part = np.arange(len(segment)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    starts = line[segment] + (part / pieces[segment])[:, None] * steps[segment]
    ends = line[segment] + ((part + 1) / pieces[segment])[:, None] * steps[segment]
    return starts, ends
