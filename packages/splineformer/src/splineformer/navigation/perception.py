"""Perception of navigators: a frozen SplineFormer reads an image's tokens and encoder output; pictures of both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor
from torch.nn import functional as F

from guide3d.opencv import cv2
from splineformer.attention import attention_map
from splineformer.decoding import decode
from splineformer.image_input import picture_of
from splineformer.modeling.curve_network import WIRES
from splineformer.predictor import Predictor

CURVE_POINTS = 96
_ONE = WIRES.index("one")
_BATCH = 8
SIDE_PX = 256  # of each half
_ATTENTION, _SPLINE, _TIP, _MARK = (255, 120, 0), (255, 40, 40), (60, 255, 60), (0, 190, 255)
_STRENGTH = 0.55  # of attention over the image
_CURVE_POINTS = 120
_SMOOTHED_PX = 0.6
_FINE_BITS = 4


@dataclass(frozen=True, eq=False)
class WireReading:
    """What was read off an image.

    Attributes:
        tokens: (limit, 3) knot as a share of the wire's length, x and y as shares of the image's side; a shorter
            sequence is continued by its last token.
        points: (n, 2) x and y of the decoded curve, tip first, shares of the side.
        encoded: (2 * width,) the encoder's output, its mean over the image, then its value at the tip.
        confidence: probability that the image shows one wire.
    """

    tokens: NDArray[np.float32]
    points: NDArray[np.float32]
    encoded: NDArray[np.float32]
    confidence: float


class PerceptionNetwork:
    """Reads images for a navigator; the network's weights stay as they are."""

    def __init__(self, predictor: Predictor) -> None:
        if predictor.input != "levels":
            raise ValueError(f"expected a network that reads grey levels, got one that reads {predictor.input}")
        self.predictor = predictor
        self.network = predictor.network

    @property
    def tokens(self) -> int:
        """Tokens of a reading."""
        return self.network.limit

    @property
    def encoded(self) -> int:
        """Numbers of the encoder's output in a reading."""
        return 2 * int(self.network.settings.width)

    def __call__(self, images: Sequence[ArrayLike]) -> list[WireReading]:
        """Reads images.

        Args:
            images: (h, w) grey levels each.

        Returns:
            A reading each; also of images without a wire, whose confidence is low.

        Raises:
            ValueError: no image.
        """
        size = self.network.settings.image_px
        pictures = [picture_of(image, size, self.predictor.source_px).pixels for image in images]
        readings: list[WireReading] = []
        for start in range(0, len(pictures), _BATCH):
            readings += self._read(torch.from_numpy(np.stack(pictures[start : start + _BATCH]))[:, None].float())
        return readings

    @torch.inference_mode()
    def _read(self, levels: Tensor) -> list[WireReading]:
        read = self.network.read(levels.to(self.predictor.device))
        encoded, tokens = read.features, read.unit_tokens()
        points = decode(tokens, read.lengths, CURVE_POINTS)
        cells = encoded.transpose(1, 2).unflatten(2, (round(encoded.shape[1] ** 0.5), -1))
        at_tip = F.grid_sample(cells, 2 * points[:, :1, None] - 1, align_corners=False, padding_mode="border")
        both = torch.cat([encoded.mean(1), at_tip[:, :, 0, 0]], 1).cpu().numpy()
        sure = torch.softmax(read.kind.wires, -1)[:, _ONE].cpu().numpy()
        rows, curves = tokens.float().cpu().numpy(), points.float().cpu().numpy()
        return [WireReading(row, curve, m, float(p)) for row, curve, m, p in zip(rows, curves, both, sure, strict=True)]


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
