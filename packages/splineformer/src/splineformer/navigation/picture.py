"""Picture of a navigator's moment: the image, and beside it attention, predicted spline, tip and target's mark."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from guide3d.opencv import cv2
from splineformer.attention import attention_map
from splineformer.navigation.perception import PerceptionNetwork

SIDE_PX = 256  # of each half
_ATTENTION, _SPLINE, _TIP, _MARK = (255, 120, 0), (255, 40, 40), (60, 255, 60), (0, 190, 255)
_STRENGTH = 0.55  # of attention over the image
_CURVE_POINTS = 120
_SMOOTHED_PX = 0.6
_FINE_BITS = 4


def picture_of_moment(image: NDArray[np.uint8], network: PerceptionNetwork, mark: ArrayLike) -> NDArray[np.uint8]:
    """Draws a camera's picture of a moment.

    Args:
        image: (h, h) grey levels.
        mark: (2,) the target's mark as shares of the sides.

    Returns:
        (SIDE_PX, 2 SIDE_PX, 3) uint8.
    """
    side = SIDE_PX
    small = cv2.resize(image, (side, side), interpolation=cv2.INTER_AREA)
    plain = np.repeat(cv2.GaussianBlur(small, (0, 0), _SMOOTHED_PX)[:, :, None], 3, axis=2)
    attention = cv2.resize(attention_map(network.predictor, image), (side, side), interpolation=cv2.INTER_LINEAR)
    weight = _STRENGTH * attention[:, :, None]
    seen = (plain * (1 - weight) + np.array(_ATTENTION) * weight).astype(np.uint8)
    reading = network([image])[0]
    places = np.linspace(0, len(reading.points) - 1, _CURVE_POINTS).round().astype(int)
    cv2.polylines(seen, [_fine(reading.points[places])], False, _SPLINE, 2, cv2.LINE_AA, _FINE_BITS)
    for place, radius, colour in ((reading.points[0], 4, _TIP), (mark, 7, _MARK)):
        cv2.circle(seen, _fine(place).tolist(), radius << _FINE_BITS, colour, 2, cv2.LINE_AA, _FINE_BITS)
    return np.concatenate((plain, seen), axis=1)


def _fine(shares: ArrayLike) -> NDArray[np.int32]:
    """Shares of the sides in sixteenths of a pixel."""
    return np.rint((np.asarray(shares, float) * SIDE_PX - 0.5) * (1 << _FINE_BITS)).astype(np.int32)
