"""What kind of image it is: how many wires it shows, and whether its grey levels are inverted."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

WIRES = ("none", "one", "several")


class ImageKind(NamedTuple):
    """Logits about an image."""

    wires: Tensor  # (B, 3) of WIRES
    inverted: Tensor  # (B,)


class ImageHead(nn.Module):
    """Two linear maps on the mean and the maximum of the encoder's features."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.hidden = nn.Sequential(nn.Linear(2 * width, width), nn.GELU())
        self.wires, self.inverted = nn.Linear(width, len(WIRES)), nn.Linear(width, 1)

    def forward(self, features: Tensor) -> ImageKind:
        """(B, N, width) features to logits."""
        hidden = self.hidden(torch.cat([features.mean(dim=1), features.amax(dim=1)], dim=-1))
        return ImageKind(self.wires(hidden), self.inverted(hidden)[:, 0])
