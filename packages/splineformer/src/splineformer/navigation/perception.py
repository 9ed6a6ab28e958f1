"""Readings for navigation: what a frozen SplineFormer makes of an image, its encoder's memory and the spline tokens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor
from torch.nn import functional as F

from splineformer.decoding import DEGREE, decode
from splineformer.image_input import picture_of
from splineformer.modeling.image_head import WIRES
from splineformer.modeling.splineformer import SplineFormer
from splineformer.predictor import Predictor

CURVE_POINTS = 96
_ONE = WIRES.index("one")
_BATCH = 8


@dataclass(frozen=True, eq=False)
class Reading:
    """What was read off an image.

    Attributes:
        tokens: (limit, 3) knot as a share of the wire's length, x and y as shares of the image's side; a shorter
            sequence is continued by its last token.
        points: (n, 2) x and y of the decoded curve, tip first, shares of the side.
        memory: (2 * width,) the encoder's memory, its mean over the image, then its value at the tip.
        confidence: probability that the image shows one wire.
    """

    tokens: NDArray[np.float32]
    points: NDArray[np.float32]
    memory: NDArray[np.float32]
    confidence: float


class Reader:
    """Reads images for a navigator; the network's weights stay as they are.

    Args:
        predictor: either variant.
    """

    def __init__(self, predictor: Predictor) -> None:
        self.predictor = predictor
        self.network = predictor.network

    @property
    def tokens(self) -> int:
        """Tokens of a reading."""
        settings = self.network.settings
        return settings.limit if isinstance(self.network, SplineFormer) else settings.control_points  # type: ignore[union-attr]

    @property
    def memory(self) -> int:
        """Numbers of a reading's memory."""
        return 2 * self.network.settings.width

    def __call__(self, images: Sequence[ArrayLike]) -> list[Reading]:
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
        told: list[Reading] = []
        for start in range(0, len(pictures), _BATCH):
            told += self._read(torch.from_numpy(np.stack(pictures[start : start + _BATCH]))[:, None].float())
        return told

    @torch.inference_mode()
    def _read(self, levels: Tensor) -> list[Reading]:
        memory, tokens, lengths, kinds = self._outputs(levels.to(self.predictor.device))
        points = decode(tokens, lengths, CURVE_POINTS)
        cells = memory.transpose(1, 2).unflatten(2, (round(memory.shape[1] ** 0.5), -1))
        at_tip = F.grid_sample(cells, 2 * points[:, :1, None] - 1, align_corners=False, padding_mode="border")
        both = torch.cat([memory.mean(1), at_tip[:, :, 0, 0]], 1).cpu().numpy()
        sure = torch.softmax(kinds, -1)[:, _ONE].cpu().numpy()
        rows, curves = tokens.float().cpu().numpy(), points.float().cpu().numpy()
        return [Reading(row, curve, m, float(p)) for row, curve, m, p in zip(rows, curves, both, sure, strict=True)]

    def _outputs(self, levels: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The (B, N, width) memory, (B, limit, 3) tokens with knots in 0 to 1, their (B,) numbers, logits of kinds."""
        network = self.network
        if isinstance(network, SplineFormer):
            memory = network.encoder(network.normalised(levels))
            decoded = network.decode(levels, memory=memory)
            lengths = decoded.lengths.clamp_min(DEGREE + 1)
            place = torch.arange(decoded.tokens.shape[1], device=levels.device)[None]
            last = (lengths - 1)[:, None]
            tokens = decoded.tokens.gather(1, torch.minimum(place, last)[..., None].expand(-1, -1, 3))
            knots = torch.cummax(tokens[..., :1].clamp_min(0), 1).values
            tokens = torch.cat([knots / knots[:, -1:].clamp_min(1e-6), tokens[..., 1:]], -1)
            return memory, tokens, lengths, decoded.kind.wires
        reading = network.read(levels)
        control = reading.control
        knots = network.knots[DEGREE + 1 :].expand(len(control), -1)[..., None]
        lengths = torch.full((len(control),), control.shape[1], device=control.device)
        return reading.memory, torch.cat([knots, control], -1), lengths, reading.said.kind.wires
