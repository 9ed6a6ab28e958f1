"""The polyline of a path: its pieces with bridges across the gaps, from the tip that the tip map shows."""

from __future__ import annotations

import numpy as np

from guide3d.geometry.polyline import Array
from guide3d.reading.links import bridges
from guide3d.reading.path_search import Path
from guide3d.reading.ridges import Pieces

_TOUCHING_PX = 6.0  # ends that are nearer need no bridge


def path_line(pieces: Pieces, path: Path) -> Array:
    """Draws a path (n, 2) px, tip first, about one point a px."""
    parts: list[Array] = []
    for number, entry in enumerate(path.entries):
        if number:
            parts.append(_gap(pieces, path.entries[number - 1] ^ 1, entry))
        points = pieces.points[entry // 2]
        parts.append(points[::-1] if entry % 2 else points)
    return np.concatenate(parts)


def to_tip(line: Array, places: Array, heights: Array, reach_px: float) -> tuple[Array, float]:
    """Moves the beginning of a path to a peak of the tip map that lies near it, beyond it or on it.

    Args:
        line: (n, 2) px, tip first, about one point a px.
        places, heights: (k, 2) px and (k,) of the peaks.
        reach_px: distance at which a peak counts 0.6 of one at the beginning; none beyond twice that.

    Returns:
        The path (m, 2), and the height of the peak, 0 without one.
    """
    if not len(places):
        return line, 0.0
    away = np.hypot(*(places - line[0]).T)
    peak = int((heights * np.exp(-0.5 * (away / reach_px) ** 2)).argmax())
    if away[peak] > 2.0 * reach_px:
        return line, 0.0
    reach = min(len(line) - 2, round(2.0 * reach_px))
    at = int(np.hypot(*(line[: reach + 1] - places[peak]).T).argmin())
    rest = line[at + 1 :] if at > 0 else line
    return np.concatenate([places[peak : peak + 1], rest]), float(heights[peak])


def _gap(pieces: Pieces, leave: int, enter: int) -> Array:
    """Points (n, 2) px between the ends of two pieces, about one a px."""
    start, end = pieces.ends[[leave]], pieces.ends[[enter]]
    length = float(np.hypot(*(end - start).T)[0])
    if length < _TOUCHING_PX:
        return np.empty((0, 2))
    return bridges(start, end, pieces.outward[[leave]], -pieces.outward[[enter]], int(length))[0]
