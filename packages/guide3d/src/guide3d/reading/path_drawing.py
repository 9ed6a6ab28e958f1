"""The polyline of a path: its pieces with bridges across the gaps, from the tip on to the border where a wire fades."""

from __future__ import annotations

import numpy as np

from guide3d.geometry.polyline import Array
from guide3d.opencv import cv2
from guide3d.reading.links import bridges
from guide3d.reading.path_search import Path
from guide3d.reading.ridges import Map, Pieces
from guide3d.setting_kinds import Angle, PixelDistance, Positive, Share, settings

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


@settings
class ProximalEndSettings:
    """How far and how straight a wire is continued.

    longest: of the continuation, as a share of the image's longer side; 0: none
    direction_px: length over which the wire's direction at its end is measured
    turn: standard deviation of a change of direction there
    bend_per_px: standard deviation of the curvature
    strength_px: px of certain wire that outweigh one standard deviation
    """

    longest: Share = 0.166
    direction_px: PixelDistance = 50.0
    turn: Angle = 0.07
    bend_per_px: Positive = 1.5e-3
    strength_px: PixelDistance = 2.0


def to_border(line: Array, probability: Map, away: Map, coarse_px: int, settings: ProximalEndSettings) -> Array:
    """Continues a path to the border of the field by the arc that explains most of what is seen there.

    Args:
        line: (n, 2) px, tip first, about one point a px.
        probability: (h, w) of 0 to 1, smoothed.
        away: distance from the border of the field, px, on a map `coarse_px` times smaller.

    Returns:
        The path (m, 2); as it was where it ends at the border already, or too far from it.
    """
    height, width = probability.shape
    # guessed, it is a third of the path at most
    longest_px = min(settings.longest * max(height, width), 0.5 * len(line))
    if longest_px < 1.0:
        return line
    part = line[-max(8, round(settings.direction_px)) :]
    direction = part[-1] - part[: max(2, len(part) // 3)].mean(axis=0)
    # a line through the last part, whose slope counts at its middle; what it bends is left to the arcs
    heading = np.arctan2(direction[1], direction[0])
    turns, bends = np.meshgrid(np.linspace(-2.5, 2.5, 11), np.linspace(-2.5, 2.5, 11), indexing="ij")
    s = np.arange(1.0, longest_px + 1.0)
    angle = heading + settings.turn * turns[..., None] + settings.bend_per_px * bends[..., None] * s
    x = line[-1, 0] + np.cumsum(np.cos(angle), axis=-1).reshape(-1, len(s))
    y = line[-1, 1] + np.cumsum(np.sin(angle), axis=-1).reshape(-1, len(s))
    column = np.clip((x / coarse_px).astype(int), 0, away.shape[1] - 1)
    row = np.clip((y / coarse_px).astype(int), 0, away.shape[0] - 1)
    left = (x < 0) | (y < 0) | (x > width - 1) | (y > height - 1) | (away[row, column] <= 0.5 * coarse_px)
    reaches = left.any(axis=1)
    if not reaches.any():
        return line
    inside = np.cumsum(left, axis=1) == 0
    seen = cv2.remap(probability, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
    value = (seen * inside).sum(axis=1) - 0.5 * settings.strength_px * (turns**2 + bends**2).ravel()
    best = int(np.where(reaches, value, -np.inf).argmax())
    count = int(inside[best].sum())
    return np.concatenate([line, np.stack([x[best, :count], y[best, :count]], axis=1)])
