"""A page that shows wires in space, to be turned with the mouse, beside the images: one file, no network."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

import numpy as np

from guide3d.opencv import cv2
from guide3d.reading.output.overlay import Picture
from guide3d.reading.pair_reading import PairReading

_TEMPLATE = "space_page.html"
_DATA = "/*DATA*/"
_STEP = 2  # every second point of a curve, one a millimetre


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
