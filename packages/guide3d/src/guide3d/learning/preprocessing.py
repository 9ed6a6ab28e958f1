"""Preprocessing: a camera's image to the small picture that a network sees, the same in training and prediction."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from guide3d.image_filters import closed, mean_around
from guide3d.opencv import cv2
from guide3d.setting_kinds import Pixels, PixelsOrNone, Positive, settings

Picture = NDArray[np.uint8]
_MIDDLE = 128.0


@settings
class Preprocessing:
    """How pictures are made.

    Attributes:
        source_px: side of the camera's image, which positions and masks belong to.
        line_px: width, in px of the camera's image, below which dark lines are kept and all else is taken away (closing
            minus image); 0: the grey values as they are.
        flat_px: side, in px of the picture, of the square whose mean is taken away from each pixel: slow shades of body
            and detector become 128; 0: they stay.
        gain: of the lines, or of what is left of the grey values.
        first_px: side, in px of the camera's image, of the squares that are averaged before lines are looked for: it
            takes away noise and most of the work.
    """

    size_px: Pixels
    source_px: Pixels = 1024
    line_px: PixelsOrNone = 0
    flat_px: PixelsOrNone = 0
    gain: Positive = 1.0
    first_px: Pixels = 1

    def __post_init__(self) -> None:
        """Refuses sizes that make no picture."""
        if self.source_px < self.size_px:
            raise ValueError(f"expected pictures of 1 to {self.source_px} px, got {self.size_px}")
        if self.line_px and self.flat_px:
            raise ValueError("give line_px or flat_px: lines have no shades to take away")
        if self.source_px % self.first_px:
            raise ValueError(f"first_px must divide {self.source_px}, got {self.first_px}")

    def __call__(self, image: NDArray[np.uint8]) -> Picture:
        """Makes a picture (size_px, size_px) uint8, area-averaged, of an image (source_px, source_px) uint8.

        Raises:
            ValueError: an image of another size or type.
        """
        expected = (self.source_px, self.source_px)
        if image.shape != expected or image.dtype != np.uint8:
            raise ValueError(
                f"expected an image of {expected[1]} x {expected[0]} px, uint8, got {image.shape}, {image.dtype}: "
                "the network was trained on that size, and its camera belongs to it"
            )
        if self.line_px:
            sharp = averaged(image, self.source_px // self.first_px)
            lines = dark_lines(sharp, self.line_px // self.first_px | 1).astype(np.float32)
            return np.clip(self.gain * averaged(lines, self.size_px), 0, 255).astype(np.uint8)
        if self.flat_px:
            grey = averaged(image.astype(np.float32), self.size_px)
            left = grey - mean_around(grey, self.flat_px)
            return np.clip(_MIDDLE + self.gain * left, 0, 255).astype(np.uint8)
        return averaged(image, self.size_px)


def averaged(image: NDArray[Any], size_px: int) -> NDArray[Any]:
    """Reduces a square image (h, h) by averaging areas."""
    if image.shape == (size_px, size_px):
        return image
    return np.asarray(cv2.resize(image, (size_px, size_px), interpolation=cv2.INTER_AREA))


def dark_lines(image: NDArray[np.uint8], width_px: int) -> Picture:
    """How much darker (h, w) uint8 images are than their surroundings, where narrower than a square of some width."""
    smooth = mean_around(image, 3)  # one bright pixel must not open a line
    return closed(smooth, width_px) - smooth
