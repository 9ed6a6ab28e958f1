"""The tip: a heat map over cells of the picture, each with a place within it, under a bell round where it is expected.

Where a wire ends is seen from near by. Which of the ends is the tip is known from the whole curve.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from splineformer.modeling.convolutions import convolution

_SPREAD = 0.06  # of the side: that of the bell before training


class TipSeen(NamedTuple):
    """What the cells predict of the tip."""

    logits: Tensor  # (B, cells), row by row, the bell among them
    offsets: Tensor  # (B, cells, 2) from a cell's centre to the tip, in cells
    place: Tensor  # (B, 2) shares of the side


class TipMap(nn.Module):
    """A fine feature map of `channels` and side², and the encoder's features of `width`, to the place of the tip."""

    cells: Tensor

    def __init__(self, channels: int, width: int, side: int, hidden: int) -> None:
        super().__init__()
        self.side = side
        self.near, self.far = nn.Conv2d(channels, hidden, 1), nn.Conv2d(width, hidden, 1)
        self.mix = convolution(hidden, hidden)
        self.out = nn.Conv2d(hidden, 3, 1)
        self.spread = nn.Parameter(torch.tensor(math.log(_SPREAD)))
        centres = (torch.arange(side) + 0.5) / side
        rows, columns = torch.meshgrid(centres, centres, indexing="ij")
        self.register_buffer("cells", torch.stack([columns, rows], -1).flatten(0, 1), persistent=False)

    def forward(self, fine: Tensor, coarse: Tensor, expected: Tensor) -> TipSeen:
        """Finds the tip.

        Args:
            fine: (B, channels, side, side).
            coarse: (B, width, h, w) features.
            expected: (B, 2) where the curve has its tip, shares of the side.
        """
        known = F.interpolate(self.far(coarse), (self.side, self.side), mode="bilinear", align_corners=False)
        predicted = self.out(self.mix(F.relu(self.near(fine) + known))).flatten(2)
        away = (self.cells - expected[:, None]).square().sum(-1)
        logits = predicted[:, 0] - away * (0.5 * torch.exp(-2.0 * self.spread))
        offsets = predicted[:, 1:].transpose(1, 2)
        best = logits.argmax(-1)[:, None, None].expand(-1, 1, 2)
        place = self.cells[best[:, 0, 0]] + offsets.gather(1, best)[:, 0] / self.side
        return TipSeen(logits, offsets, place)


def led_to(points: Tensor, tip: Tensor) -> Tensor:
    """Leads (B, n, 2) points, tip first, to their (B, 2) tips: all of the way at the tip, less and less behind it."""
    share = torch.linspace(1.0, 0.0, points.shape[1], device=points.device).square()
    return points + share[:, None] * (tip - points[:, 0])[:, None]
