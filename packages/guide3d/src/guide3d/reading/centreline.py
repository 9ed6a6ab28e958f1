"""The centre line along a path of pieces, below the pixel: smoothed, with confidence and deviation."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from guide3d.geometry.polyline import Array, arc_length, at_length
from guide3d.opencv import cv2
from guide3d.reading.ridges import Map
from guide3d.reconstruction.curve_fitting import smoothed
from guide3d.setting_kinds import PixelDistance, Positive, Weight, settings


@settings
class CentrelineSettings:
    """How a centre line is measured.

    spacing_px: of its points
    across_px: how far to both sides the ridge is looked for
    stiffness_px: length over which the line is smoothed
    noise_px: standard deviation of a point on a probable ridge
    growth: growth of the standard deviation by distance from the nearest probable point
    sure: confidence from which a point counts as probable
    blend_points: standard deviation of the Gaussian that smooths the confidence along the line, in points
    """

    spacing_px: PixelDistance = 2.0
    across_px: PixelDistance = 4.0
    stiffness_px: PixelDistance = 5.0
    noise_px: PixelDistance = 0.7
    growth: Weight = 0.12
    sure: Positive = 0.5
    blend_points: Weight = 2.0


def centre_line(path: Array, probability: Map, settings: CentrelineSettings) -> tuple[Array, Array, Array]:
    """Measures the centre line along a path.

    Args:
        path: (n, 2) px, tip first, straight across gaps.
        probability: (h, w) of 0 to 1, smoothed.

    Returns:
        Points (m, 2) px at nearly equal spacing, their confidence (m,) of 0 to 1, and their standard deviation (m,) px
        across the line.
    """
    length = arc_length(path)[-1]
    count = max(4, int(length / settings.spacing_px) + 1)
    line = at_length(path, np.linspace(0.0, length, count))
    for _ in range(2):
        normal = _normals(line, settings)
        offset, weight = _off_ridge(line, normal, probability, settings.across_px)
        target = line + offset[:, None] * normal
        weight = weight + 0.05  # across gaps the line keeps the course of the bridge
        weight[[0, -1]] = np.maximum(weight[[0, -1]], 0.3)
        stiffness = (settings.stiffness_px / settings.spacing_px) ** 4
        line = smoothed(target, weight, stiffness)
    line = at_length(line, np.linspace(0.0, arc_length(line)[-1], count))
    _, weight = _off_ridge(line, _normals(line, settings), probability, 2.0)
    confidence = np.clip(gaussian_filter1d(weight, settings.blend_points, mode="nearest"), 0.0, 1.0)
    return line, confidence, _deviation(line, confidence, settings)


def _normals(line: Array, settings: CentrelineSettings) -> Array:
    smooth = gaussian_filter1d(line, 3.0 / settings.spacing_px, axis=0, mode="nearest")
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


def _deviation(line: Array, confidence: Array, settings: CentrelineSettings) -> Array:
    along = arc_length(line)
    sure = along[confidence >= settings.sure]
    if not len(sure):
        return np.full(len(line), settings.noise_px + settings.growth * along[-1])
    at = np.clip(np.searchsorted(sure, along), 1, len(sure) - 1) if len(sure) > 1 else np.zeros(len(along), int)
    away = np.minimum(np.abs(along - sure[at]), np.abs(along - sure[np.maximum(at - 1, 0)]))
    return np.asarray(np.hypot(settings.noise_px, settings.growth * away))
