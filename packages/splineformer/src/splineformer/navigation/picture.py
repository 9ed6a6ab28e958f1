"""Picture of a navigator's moment: the image, and beside it attention, predicted spline, tip and target's mark."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFilter

from splineformer.attention import attention_map
from splineformer.navigation.perception import PerceptionNetwork

SIDE_PX = 256  # of each half
_ATTENTION, _SPLINE, _TIP, _MARK = (255, 120, 0), (255, 40, 40), (60, 255, 60), (0, 190, 255)
_STRENGTH = 0.55  # of attention over the image
_CURVE_POINTS = 120
_SMOOTHED_PX = 0.6


def picture_of_moment(image: NDArray[np.uint8], network: PerceptionNetwork, mark: ArrayLike) -> NDArray[np.uint8]:
    """Draws a camera's picture of a moment.

    Args:
        image: (h, h) grey levels.
        mark: (2,) the target's mark as shares of the sides.

    Returns:
        (SIDE_PX, 2 SIDE_PX, 3) uint8.
    """
    side = SIDE_PX
    small = Image.fromarray(image).resize((side, side), Image.Resampling.BOX)
    grey = np.asarray(small.filter(ImageFilter.GaussianBlur(_SMOOTHED_PX)))
    plain = np.repeat(grey[:, :, None], 3, axis=2)
    attention = Image.fromarray(attention_map(network.network, image))
    weight = _STRENGTH * np.asarray(attention.resize((side, side), Image.Resampling.BILINEAR))[:, :, None]
    seen = Image.fromarray((plain * (1 - weight) + np.array(_ATTENTION) * weight).astype(np.uint8))
    reading = network([image])[0]
    draw = ImageDraw.Draw(seen)
    places = np.linspace(0, len(reading.points) - 1, _CURVE_POINTS).round().astype(int)
    draw.line([tuple(point) for point in (side * reading.points[places]).tolist()], fill=_SPLINE, width=2)
    for place, radius, colour in ((reading.points[0], 4, _TIP), (mark, 7, _MARK)):
        x, y = (side * np.asarray(place, float)).tolist()
        draw.ellipse((x - radius, y - radius, x + radius, y + radius), outline=colour, width=2)
    return np.concatenate((plain, np.asarray(seen)), axis=1)
