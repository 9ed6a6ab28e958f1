"""Image input: any grey image, of any size and depth, to the square picture of 8 bits that the networks see."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from guide3d.opencv import cv2
from guide3d.reading.grey_image import grey_levels

SMALLEST_PX = 64


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
        image: as `guide3d.reading.grey_image.grey_levels` takes it.
        expected_px: side of the images that the network was trained on; others get a warning.

    Returns:
        The picture; a shorter side is filled up with black, at the right or below.

    Raises:
        ValueError: no image, a coloured or a tiny one, or one without any contrast.
    """
    array, warnings = grey_levels(image, SMALLEST_PX)
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


def shares_of_pixels(points_px: NDArray[np.float64], size_px: tuple[float, float]) -> NDArray[np.float64]:
    """Pixel coordinates, (0, 0) the first pixel's centre, to shares of the image's sides, 0 its border."""
    return (np.asarray(points_px, float) + 0.5) / np.asarray(size_px, float)


def pixels_of_shares(shares: NDArray[np.float64], size_px: tuple[float, float]) -> NDArray[np.float64]:
    """Shares of the image's sides to pixel coordinates."""
    return np.asarray(shares, float) * np.asarray(size_px, float) - 0.5
