"""The line along a path of pieces: bridges across gaps, on to the border where a wire fades, and its centre."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from guide3d.geometry.polyline import Array, arc_length, at_length
from guide3d.opencv import cv2
from guide3d.reading.links import bridges
from guide3d.reading.path_search import Path
from guide3d.reading.ridges import Map, Pieces
from guide3d.reconstruction.curve_fitting import smoothed

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


# How far and how straight a wire is continued.
_LONGEST = 0.166  # of the continuation, as a share of the image's longer side; 0: none
_DIRECTION_PX = 50.0  # length over which the wire's direction at its end is measured
_TURN = 0.07  # standard deviation of a change of direction there
_BEND_PER_PX = 1.5e-3  # standard deviation of the curvature
_STRENGTH_PX = 2.0  # px of certain wire that outweigh one standard deviation


def to_border(line: Array, probability: Map, away: Map, coarse_px: int) -> Array:
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
    longest_px = min(_LONGEST * max(height, width), 0.5 * len(line))
    if longest_px < 1.0:
        return line
    part = line[-max(8, round(_DIRECTION_PX)) :]
    direction = part[-1] - part[: max(2, len(part) // 3)].mean(axis=0)
    # a line through the last part, whose slope counts at its middle; what it bends is left to the arcs
    heading = np.arctan2(direction[1], direction[0])
    turns, bends = np.meshgrid(np.linspace(-2.5, 2.5, 11), np.linspace(-2.5, 2.5, 11), indexing="ij")
    s = np.arange(1.0, longest_px + 1.0)
    angle = heading + _TURN * turns[..., None] + _BEND_PER_PX * bends[..., None] * s
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
    value = (seen * inside).sum(axis=1) - 0.5 * _STRENGTH_PX * (turns**2 + bends**2).ravel()
    best = int(np.where(reaches, value, -np.inf).argmax())
    count = int(inside[best].sum())
    return np.concatenate([line, np.stack([x[best, :count], y[best, :count]], axis=1)])


# How a centre line is measured.
_SPACING_PX = 2.0  # of its points
_ACROSS_PX = 4.0  # how far to both sides the ridge is looked for
_STIFFNESS_PX = 5.0  # length over which the line is smoothed
_NOISE_PX = 0.7  # standard deviation of a point on a probable ridge
_GROWTH = 0.12  # growth of the standard deviation by distance from the nearest probable point
_SURE = 0.5  # confidence from which a point counts as probable
_BLEND_POINTS = 2.0  # standard deviation of the Gaussian that smooths the confidence along the line, in points


def centre_line(path: Array, probability: Map) -> tuple[Array, Array, Array]:
    """Measures the centre line along a path.

    Args:
        path: (n, 2) px, tip first, straight across gaps.
        probability: (h, w) of 0 to 1, smoothed.

    Returns:
        Points (m, 2) px at nearly equal spacing, their confidence (m,) of 0 to 1, and their standard deviation (m,) px
        across the line.
    """
    length = arc_length(path)[-1]
    count = max(4, int(length / _SPACING_PX) + 1)
    line = at_length(path, np.linspace(0.0, length, count))
    for _ in range(2):
        normal = _normals(line)
        offset, weight = _off_ridge(line, normal, probability, _ACROSS_PX)
        target = line + offset[:, None] * normal
        weight = weight + 0.05  # across gaps the line keeps the course of the bridge
        weight[[0, -1]] = np.maximum(weight[[0, -1]], 0.3)
        stiffness = (_STIFFNESS_PX / _SPACING_PX) ** 4
        line = smoothed(target, weight, stiffness)
    line = at_length(line, np.linspace(0.0, arc_length(line)[-1], count))
    _, weight = _off_ridge(line, _normals(line), probability, 2.0)
    confidence = np.clip(gaussian_filter1d(weight, _BLEND_POINTS, mode="nearest"), 0.0, 1.0)
    return line, confidence, _deviation(line, confidence)


def _normals(line: Array) -> Array:
    smooth = gaussian_filter1d(line, 3.0 / _SPACING_PX, axis=0, mode="nearest")
    tangent = np.gradient(smooth, axis=0)
    tangent /= np.maximum(np.hypot(*tangent.T), 1e-9)[:, None]
    return np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)


def _off_ridge(line: Array, normal: Array, probability: Map, across_px: float) -> tuple[Array, Array]:
    """Distance (n,) px of the ridge across a line, and the largest probability (n,) there."""
    off = np.linspace(-across_px, across_px, 2 * round(across_px) + 1)
    places = np.asarray(line[:, None] + off[None, :, None] * normal[:, None], np.float32)
    seen = cv2.remap(probability, places[..., 0], places[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    seen = np.asarray(seen, float)
    weight = seen**2 * np.exp(-0.5 * (off / (0.6 * across_px)) ** 2)
    total = weight.sum(axis=1)
    return (weight @ off) / np.maximum(total, 1e-6), seen.max(axis=1)


def _deviation(line: Array, confidence: Array) -> Array:
    along = arc_length(line)
    sure = along[confidence >= _SURE]
    if not len(sure):
        return np.full(len(line), _NOISE_PX + _GROWTH * along[-1])
    at = np.clip(np.searchsorted(sure, along), 1, len(sure) - 1) if len(sure) > 1 else np.zeros(len(along), int)
    away = np.minimum(np.abs(along - sure[at]), np.abs(along - sure[np.maximum(at - 1, 0)]))
    return np.asarray(np.hypot(_NOISE_PX, _GROWTH * away))
