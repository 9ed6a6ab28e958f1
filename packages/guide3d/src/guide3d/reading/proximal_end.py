"""Continues a wire that fades inside the field: it came in from outside, so it goes on to the border."""

from __future__ import annotations

import numpy as np

from guide3d.geometry.polyline import Array
from guide3d.opencv import cv2
from guide3d.reading.ridges import Map
from guide3d.setting_kinds import Angle, PixelDistance, Positive, Share, settings


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
