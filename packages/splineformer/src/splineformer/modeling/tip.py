"""The tip predictor: a small convolutional network that gives the first token."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

_CHANNELS = (16, 32, 64, 128)
_SIDE = 8  # of the last feature map
_HIDDEN = 512


class TipPredictor(nn.Module):
    """Convolutions of stride 2, then 512 units, then the start token by softplus.

    Args:
        image_px: side of the image.
        seen_px: it is averaged down to this side first; what the convolutions leave is pooled to 8 x 8 cells.
    """

    def __init__(self, image_px: int, seen_px: int) -> None:
        super().__init__()
        self.shrink = max(image_px // seen_px, 1)
        layers: list[nn.Module] = []
        before = 1
        for channels in _CHANNELS:
            layers += [nn.Conv2d(before, channels, 3, 2, 1), nn.BatchNorm2d(channels), nn.ReLU()]
            before = channels
        self.convolutions = nn.Sequential(*layers, nn.AdaptiveAvgPool2d(_SIDE))
        self.hidden = nn.Sequential(nn.Flatten(), nn.Linear(before * _SIDE**2, _HIDDEN), nn.ReLU())
        self.out = nn.Linear(_HIDDEN, 3)

    def forward(self, image: Tensor) -> Tensor:
        """(B, 1, h, w) images to (B, 3) knot, x, y of the first token."""
        if self.shrink > 1:
            image = F.avg_pool2d(image, self.shrink)
        token: Tensor = F.softplus(self.out(self.hidden(self.convolutions(image))))
        return token

    @torch.no_grad()
    def start_at(self, token: Tensor) -> None:
        """Sets the last bias so that an untrained network gives this (3,) token."""
        self.out.bias.copy_(torch.log(torch.expm1(token.clamp_min(1e-3))))
