"""Pictures of maps: what guide3d's reader makes of an X-ray image, for networks that read dark lines.

At a quarter of its size an image has lost a wire of 1 to 2 px, or it cannot be told from the walls around it. The
reader looks at the full size, up to 1024 px: its maps are drawn as dark lines on white, which stay visible when they
are made small.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from guide3d.opencv import cv2
from guide3d.reading.grey_image import READ_PX, grey_image
from guide3d.reading.image_reading import MapReader
from splineformer.image_input import Picture

WHITE = 255.0
WIRE, TIP = 170.0, 85.0  # grey levels that a certain wire is darker than white, and its tip darker than it
_SEEN = 0.5  # of the map of wires, counted in a picture
_FAINT = 0.25  # of the picture's side: pixels of wire with less of which the negative is tried
_CLEARER = 2.0  # times as much wire in the negative, and it is taken


def map_picture(wire: NDArray[Any], tip: NDArray[Any]) -> NDArray[np.uint8]:
    """Draws maps: white, darker where there is wire, darkest where there is its tip.

    Args:
        wire, tip: (size, size) uint8, 255 where certain.
    """
    levels = WHITE - WIRE / 255.0 * wire - TIP / 255.0 * tip
    return np.asarray(np.clip(np.rint(levels), 0, 255), np.uint8)


def reduced(wire: NDArray[np.float32], tip: NDArray[np.float32], size_px: int) -> NDArray[np.uint8]:
    """Makes the picture (size, size) of square maps (h, h) of 0 to 1.

    Wires are averaged, so that they stay in their places; of tips the largest value stays, so that they are seen.
    """
    side = len(wire)
    if side % size_px:
        whole = size_px * -(-side // size_px)
        wire = np.asarray(cv2.resize(wire, (whole, whole)), np.float32)
        tip = np.asarray(cv2.resize(tip, (whole, whole)), np.float32)
    small = cv2.resize(wire, (size_px, size_px), interpolation=cv2.INTER_AREA)
    cells = len(tip) // size_px
    largest = tip.reshape(size_px, cells, size_px, cells).max(axis=(1, 3))
    return map_picture(_eight_bits(np.asarray(small, np.float32)), _eight_bits(largest))


def picture_by_reader(image: ArrayLike, size_px: int, reader: MapReader) -> Picture:
    """Lets a reader read an image and makes a picture of its maps.

    Args:
        image: (h, w) grey values of any depth; a negative is recognised and inverted.

    Returns:
        The picture; a shorter side of the image is filled up with white, at the right or below.

    Raises:
        ValueError: no image, a coloured or a tiny one, or one without any contrast.
    """
    grey = grey_image(image)
    warnings = list(grey.messages)
    grey = grey.resampled(min(max(grey.pixels.shape), READ_PX))
    picture, inverted = _read(grey.pixels, size_px, reader), False
    seen = wire_seen(picture)
    faint = _FAINT * size_px
    if seen < faint:
        negative = _read(255 - grey.pixels, size_px, reader)
        if wire_seen(negative) > max(faint, _CLEARER * seen):
            picture, inverted = negative, True
    return Picture(picture, max(grey.pixels.shape) * grey.scale, tuple(warnings), inverted)


def wire_seen(picture: NDArray[np.uint8]) -> float:
    """How many pixels of a (size, size) picture show wire rather than not."""
    return float((picture < WHITE - _SEEN * WIRE).sum())


def _read(pixels: NDArray[np.uint8], size_px: int, reader: MapReader) -> NDArray[np.uint8]:
    maps = reader.maps(pixels)
    height, width = pixels.shape
    side = max(height, width)
    beyond = ((0, side - height), (0, side - width))
    return reduced(np.pad(maps.wire, beyond), np.pad(maps.tip, beyond), size_px)


def _eight_bits(values: NDArray[np.float32]) -> NDArray[np.uint8]:
    return np.clip(np.rint(255.0 * values), 0, 255).astype(np.uint8)
