"""An image as readers take it: 8 bits of grey, at the scales that were trained on, and what is not exposed in it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from os import PathLike

import numpy as np
from numpy.typing import ArrayLike, NDArray

from guide3d.image_file import SHOWN_WHITE, shown_range
from guide3d.opencv import cv2

SMALLEST_PX = 128  # of a side: a wire and what is around it
READ_PX = 1024  # of the longer side: in images of that size the reader knows wires 1 to 4.5 px wide
_LARGEST = 1e30  # of real numbers, which are worked with in single precision
_COLOUR = 12  # grey levels between the channels of a pixel that is coloured
_COARSE = 8


@dataclass(frozen=True, eq=False)
class GreyImage:
    """An image that can be read.

    pixels: (h, w) uint8
    scales: (2,) px of the image given per px of `pixels`, in x and y
    outside: (h, w) pixels that were not exposed: the black rim of a round field
    messages: what had to be done to the image, as sentences
    """

    pixels: NDArray[np.uint8]
    scales: NDArray[np.float64]
    outside: NDArray[np.bool_]
    messages: list[str]

    @property
    def scale(self) -> float:
        """Px of the image given per px of `pixels`, mean of x and y."""
        return float(self.scales.mean())

    def resampled(self, side_px: int) -> GreyImage:
        """The image with a longer side of `side_px`."""
        height, width = self.pixels.shape
        longer = max(height, width)
        if longer == side_px:
            return self
        size = tuple(max(1, round(side * side_px / longer)) for side in (width, height))
        way = cv2.INTER_AREA if longer > side_px else cv2.INTER_CUBIC
        pixels = np.asarray(cv2.resize(self.pixels, size, interpolation=way), np.uint8)
        return GreyImage(pixels, self.scales * (width / size[0], height / size[1]), not_exposed(pixels), self.messages)

    def at_known_scales(self) -> list[GreyImage]:
        """The image of the side that the reader knows; a small one at half of it, too, where wide wires are known."""
        longer = max(self.pixels.shape)
        least = math.ceil(SMALLEST_PX * longer / min(self.pixels.shape))  # a long strip stays as wide as a wire needs
        sides = [READ_PX] if longer >= READ_PX else [READ_PX, READ_PX // 2]
        return [self.resampled(max(side, min(least, longer))) for side in sides]

    def to_given(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Takes (n, 2) px of `pixels` to those of the image given."""
        return (points + 0.5) * self.scales - 0.5

    def from_given(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Takes (n, 2) px of the image given to those of `pixels`."""
        return (points + 0.5) / self.scales - 0.5


def grey_image(image: ArrayLike) -> GreyImage:
    """Checks an image and brings it to 8 bits, at its own scale; takes and raises what `grey_levels` does."""
    pixels, messages = grey_levels(image)
    return GreyImage(pixels, np.ones(2), not_exposed(pixels), messages)


def grey_levels(image: ArrayLike, smallest_px: int = SMALLEST_PX) -> tuple[NDArray[np.uint8], list[str]]:
    """Checks an image and brings it to 8 bits.

    Args:
        image: (h, w), or (h, w, 3) without colours; bytes, 16 bits, or real numbers, of at most 1e30.
        smallest_px: of a side.

    Returns:
        (h, w) pixels, and what had to be done to the image, as sentences.

    Raises:
        ValueError: no image, a coloured or a tiny one, or one without any contrast.
    """
    if isinstance(image, str | PathLike):
        raise ValueError(
            f"expected an image's grey values, got the path {str(image)!a:.200}: "
            "read the file first, by guide3d.image_file.read_grey_levels(path)"
        )
    values = np.asarray(image)
    messages: list[str] = []
    if values.dtype.kind == "f" and values.size and not max(-float(values.min()), float(values.max())) <= _LARGEST:
        raise ValueError(f"expected finite grey values of at most {_LARGEST:g}, found some that are not")
    if values.ndim == 3 and values.shape[2] in (1, 2, 3, 4):
        values = _without_colour(values, messages)
    if values.ndim != 2 or values.dtype.kind not in "uif":
        raise ValueError(f"expected a grey image (h, w) of numbers, got shape {values.shape} of {values.dtype}")
    height, width = values.shape
    if min(height, width) < smallest_px:
        raise ValueError(
            f"expected an image of at least {smallest_px} x {smallest_px} px, got {width} x {height}: "
            "too small to tell a wire from its surroundings"
        )
    low, high = float(values.min()), float(values.max())
    if high - low < 1e-3 * max(abs(high), abs(low), 1e-9) or (values.dtype == np.uint8 and high - low < 3.0):
        raise ValueError(f"the image has no contrast: its grey values are {low:g} to {high:g}")
    pixels = values if values.dtype == np.uint8 else _eight_bits(values, messages)
    return np.ascontiguousarray(pixels), messages


def not_exposed(pixels: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Finds the dark parts (h, w) around the exposed field that reach the border of an image."""
    height, width = pixels.shape
    size = (max(width // _COARSE, 1), max(height // _COARSE, 1))
    small = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    bright = float(np.percentile(small, 90))
    dark = (small <= max(0.08 * bright, 1.0)).astype(np.uint8)
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(dark, connectivity=4)
    outside = np.zeros(small.shape, np.uint8)
    border = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    for label in np.unique(border[border > 0]):
        if statistics[label, cv2.CC_STAT_AREA] >= 0.003 * small.size:
            outside[labels == label] = 1
    return np.asarray(cv2.resize(outside, (width, height), interpolation=cv2.INTER_NEAREST) > 0)


def _without_colour(values: NDArray[np.generic], messages: list[str]) -> NDArray[np.generic]:
    if values.shape[2] in (1, 2):
        return np.asarray(values[..., 0])
    channels = values[..., :3].astype(float)
    top = max(float(channels.max()), 1e-9)
    spread = np.ptp(channels, axis=2) * (255.0 / top)
    coloured = float((spread > _COLOUR).mean())
    if coloured > 0.05:
        raise ValueError(f"expected a grey X-ray image, got a picture of which {coloured:.0%} is coloured")
    if coloured:
        messages.append("coloured marks of the image were read as grey")
    return np.asarray(values[..., :3].mean(axis=2).astype(values.dtype))


def _eight_bits(values: NDArray[np.generic], messages: list[str]) -> NDArray[np.uint8]:
    levels = values.astype(np.float32)
    low, high = shown_range(levels)
    messages.append(f"grey values of {low:g} to {high:g} were taken to 8 bits")
    return np.clip(np.rint((levels - low) * (SHOWN_WHITE / (high - low))), 0, 255).astype(np.uint8)
