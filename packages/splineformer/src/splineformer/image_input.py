"""Image input: any grey image, of any size and depth, to the square picture of 8 bits that the networks see."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from guide3d.opencv import cv2

SMALLEST_PX = 64
_TAILS_PCT = (0.1, 99.9)  # of the grey levels that may be cut off when a deep image is brought to 8 bits


@dataclass(frozen=True, eq=False)
class Picture:
    """An image as a network sees it.

    Attributes:
        pixels: (size, size) uint8.
        side_px: side of the square, in pixels of the image, that the picture shows; its corner is the image's.
        warnings: sentences about what had to be done to the image.
        inverted: grey levels were turned over already, as the wire is brighter than its surroundings.
    """

    pixels: NDArray[np.uint8]
    side_px: float
    warnings: tuple[str, ...]
    inverted: bool = False


def picture_of(image: ArrayLike, size_px: int, expected_px: int) -> Picture:
    """Brings an image to the network's size.

    Args:
        image: (h, w) grey levels, or (h, w, 3) with three equal channels; uint8 as it is, other types are spread over
            0 to 255.
        expected_px: side of the images that the network was trained on; others get a warning.

    Returns:
        The picture; a shorter side is filled up with black, at the right or below.

    Raises:
        ValueError: another shape, too small, not finite, or all of one grey level.
    """
    array = np.asarray(image)
    warnings = []
    if array.ndim == 3 and array.shape[2] in (3, 4):
        if (array[..., 0] != array[..., 1]).any() or (array[..., 0] != array[..., 2]).any():
            raise ValueError("expected a grey image, got a coloured one: convert it first")
        array = array[..., 0]
    if array.ndim != 2 or min(array.shape) < SMALLEST_PX:
        raise ValueError(f"expected a grey image of at least {SMALLEST_PX} px a side, got shape {array.shape}")
    if array.dtype != np.uint8:
        warnings.append(f"{array.dtype} grey levels were spread over 0 to 255")
        array = _eight_bits(array)
    if array.min() == array.max():
        raise ValueError(f"expected an image, got one grey level ({int(array.min())}) everywhere")
    height, width = array.shape
    side = max(height, width)
    if (height, width) != (expected_px, expected_px):
        warnings.append(f"{width} x {height} px instead of {expected_px} x {expected_px}")
    if height != width:
        square = np.zeros((side, side), np.uint8)
        square[:height, :width] = array
        array = square
    if side != size_px:
        # areas are averaged on the way down; there is nothing to average on the way up
        way = cv2.INTER_AREA if side > size_px else cv2.INTER_LINEAR
        array = np.asarray(cv2.resize(array, (size_px, size_px), interpolation=way), np.uint8)
    return Picture(array, float(side), tuple(warnings))


def _eight_bits(array: NDArray[np.generic]) -> NDArray[np.uint8]:
    levels = array.astype(np.float64)
    if not np.isfinite(levels).all():
        raise ValueError("expected finite grey levels")
    low, high = np.percentile(levels, _TAILS_PCT)
    if high <= low:
        low, high = levels.min(), levels.max()
    return np.clip(np.round((levels - low) * (255.0 / max(high - low, 1e-12))), 0, 255).astype(np.uint8)


def shares_of_pixels(points_px: NDArray[np.float64], size_px: tuple[float, float]) -> NDArray[np.float64]:
    """Pixel coordinates, (0, 0) the first pixel's centre, to shares of the image's sides, 0 its border."""
    return (np.asarray(points_px, float) + 0.5) / np.asarray(size_px, float)


def pixels_of_shares(shares: NDArray[np.float64], size_px: tuple[float, float]) -> NDArray[np.float64]:
    """Shares of the image's sides to pixel coordinates."""
    return np.asarray(shares, float) * np.asarray(size_px, float) - 0.5
