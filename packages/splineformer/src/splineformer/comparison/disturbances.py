"""Disturbances that images are read under: noise, low contrast, and bars that hide parts of the wire."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from guide3d.geometry.polyline import Array, arc_length, at_length

KINDS = ("none", "noise", "low_contrast", "occlusion")
NOISE_SD = 12.0  # grey levels, at the camera's resolution
GAIN = 0.35  # of the contrast that is left
DETECTOR_SD = 2.0  # grey levels of noise that do not shrink with the contrast
BARS = 3
BAR_PX = (30.0, 70.0)  # side of a bar over a 1,024 px image
_COVERED = (0.15, 0.85)  # shares of the wire's length where bars may lie: tip and end stay in sight

Image = NDArray[np.uint8]


def disturbed(kind: str, image: Image, wire_px: Array, generator: np.random.Generator) -> Image:
    """Disturbs an image.

    Args:
        kind: one of `KINDS`.
        image: (h, w) uint8.
        wire_px: (n, 2) the true wire, tip first: bars lie on it.

    Returns:
        (h, w) uint8, a new image unless the kind is "none".

    Raises:
        ValueError: another kind.
    """
    if kind == "none":
        return image
    if kind == "occlusion":
        return _hidden(image, wire_px, generator)
    levels = image.astype(np.float32)
    if kind == "noise":
        levels += NOISE_SD * generator.standard_normal(image.shape, np.float32)
    elif kind == "low_contrast":
        middle = levels.mean()
        levels = middle + GAIN * (levels - middle) + DETECTOR_SD * generator.standard_normal(image.shape, np.float32)
    else:
        raise ValueError(f"unknown disturbance '{kind}'; there are {', '.join(KINDS)}")
    return np.clip(np.round(levels), 0, 255).astype(np.uint8)


def _hidden(image: Image, wire_px: Array, generator: np.random.Generator) -> Image:
    covered = image.copy()
    length = arc_length(wire_px)[-1]
    height, width = image.shape
    for share in generator.uniform(*_COVERED, BARS):
        x, y = at_length(wire_px, [share * length])[0]
        half = generator.uniform(*BAR_PX, 2) * max(image.shape) / 1024 / 2
        rows = slice(max(int(y - half[1]), 0), min(int(y + half[1]) + 1, height))
        columns = slice(max(int(x - half[0]), 0), min(int(x + half[0]) + 1, width))
        covered[rows, columns] = int(generator.uniform(30, 180))
    return covered
