"""Pictures of readings: the image with the curve on it, coloured by confidence, and a page with the wire in space."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from guide3d.geometry.polyline import Array
from guide3d.opencv import cv2
from guide3d.reading.image_reading import ImageReading
from guide3d.reading.pair_reading import PairReading

Picture = NDArray[np.uint8]

_FINE_BITS = 4
_TIP, _OTHER = (255, 255, 80), (80, 170, 255)
_LOW, _MIDDLE, _HIGH = (255, 60, 50), (255, 200, 40), (60, 230, 90)  # colours of confidence


_TEMPLATE = "space_page.html"
_DATA = "/*DATA*/"
_STEP = 2  # every second point of a curve, one a millimetre


def confidence_colour(confidence: float) -> tuple[int, int, int]:
    """Colour of a confidence of 0 (red) over 0.5 (yellow) to 1 (green)."""
    share = float(np.clip(confidence, 0.0, 1.0)) * 2.0
    low, high = (_LOW, _MIDDLE) if share < 1.0 else (_MIDDLE, _HIGH)
    part = share % 1.0 if share < 2.0 else 1.0
    red, green, blue = (round(a + part * (b - a)) for a, b in zip(low, high, strict=True))
    return red, green, blue


def draw_reading(image: ArrayLike, reading: ImageReading) -> Picture:
    """Draws a reading on its image.

    Args:
        image: (h, w) grey values.

    Returns:
        (h, w, 3) RGB, brightened.
    """
    picture = _ground(np.asarray(image))
    for other in reading.others:
        _curve(picture, other.points_px, _OTHER)
    if reading.found:
        for start, end, confidence in zip(
            reading.points_px[:-1], reading.points_px[1:], reading.confidence[1:], strict=True
        ):
            cv2.line(picture, _at(start), _at(end), confidence_colour(confidence), 1, cv2.LINE_AA, _FINE_BITS)
        radius = round(max(picture.shape[:2]) / 128) << _FINE_BITS
        cv2.circle(picture, _at(reading.points_px[0]), radius, _TIP, 1, cv2.LINE_AA, _FINE_BITS)
    return picture


def _ground(image: NDArray[np.generic]) -> Picture:
    levels = image.astype(np.float32)
    levels = levels if levels.ndim == 2 else levels[..., :3].mean(axis=2)
    low, high = (float(level) for level in np.percentile(levels[::4, ::4], (0.5, 99.5)))
    grey = np.clip((levels - low) * (215.0 / max(high - low, 1e-6)) + 10.0, 0, 255).astype(np.uint8)
    return np.repeat(grey[:, :, None], 3, axis=2)


def _curve(picture: Picture, points: Array, colour: tuple[int, int, int]) -> None:
    fine = np.rint(np.asarray(points) * (1 << _FINE_BITS)).astype(np.int32)
    cv2.polylines(picture, [fine], False, colour, 1, cv2.LINE_AA, _FINE_BITS)


def _at(place: Array) -> tuple[int, int]:
    x, y = np.rint(np.asarray(place) * (1 << _FINE_BITS)).astype(int)
    return int(x), int(y)


def space_page(readings: Sequence[PairReading | None], pictures: Sequence[Picture], title: str) -> str:
    """Builds the page of a wire, or of a sequence with a slider.

    Args:
        readings: of each frame; None where there is none. One at least is a wire.
        pictures: RGB images that are shown beside it, such as the overlays of both views.
        title: of the page.

    Returns:
        HTML with its script, data and pictures inside.
    """
    data = {
        "title": title,
        "frames": [None if reading is None else _frame(reading) for reading in readings],
        "pictures": [_as_address(picture) for picture in pictures],
    }
    template = (files("guide3d.reading.output") / _TEMPLATE).read_text(encoding="utf-8")
    # "</" would end the script element
    return template.replace(_DATA, json.dumps(data, allow_nan=False).replace("</", "<\\/"), 1)


def _frame(reading: PairReading) -> dict[str, Any]:
    keep = np.unique(np.append(np.arange(0, len(reading.curve_mm), _STEP), len(reading.curve_mm) - 1))
    return {
        "points": np.round(reading.curve_mm[keep], 3).tolist(),
        "sd": np.round(reading.sd_mm[keep], 3).tolist(),
        "length": round(reading.reconstruction.length_mm, 1),
        "messages": list(reading.messages),
    }


def _as_address(picture: Picture) -> str:
    _, coded = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])
    return "data:image/jpeg;base64," + base64.b64encode(coded.tobytes()).decode()
