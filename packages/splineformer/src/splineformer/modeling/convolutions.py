"""Convolutional parts of the ordered variant: a stem that halves the picture again and again."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional as F


def convolution(before: int, after: int, stride: int = 1, kernel: int = 3) -> nn.Sequential:
    """Convolution, batch normalisation and ReLU."""
    return nn.Sequential(
        nn.Conv2d(before, after, kernel, stride, kernel // 2, bias=False), nn.BatchNorm2d(after), nn.ReLU(inplace=True)
    )


class Residual(nn.Module):
    """Two convolutions added to their input."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = convolution(channels, channels)
        self.second = nn.Sequential(nn.Conv2d(channels, channels, 3, 1, 1, bias=False), nn.BatchNorm2d(channels))

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, h, w) to the same."""
        return F.relu(x + self.second(self.first(x)))


class Stem(nn.Module):
    """Halvings of the image, each a convolution of stride 2 and residual blocks.

    Args:
        before: channels of the image.
        channels: of each halving.
        blocks: residual blocks of each halving.
    """

    def __init__(self, before: int, channels: Sequence[int], blocks: Sequence[int]) -> None:
        super().__init__()
        self.levels = nn.ModuleList()
        for number, (after, count) in enumerate(zip(channels, blocks, strict=True)):
            first = convolution(before, after, 2, 5 if number == 0 else 3)
            self.levels.append(nn.Sequential(first, *(Residual(after) for _ in range(count))))
            before = after

    def forward(self, x: Tensor) -> list[Tensor]:
        """(B, C, h, w) images to the feature map after each halving."""
        maps = []
        for level in self.levels:
            x = level(x)
            maps.append(x)
        return maps


def box_means(x: Tensor, side: int) -> Tensor:
    """Means over square neighbourhoods of odd side; at the border over what lies inside."""
    # row by row, then column by column: the work grows with the side, not with its square
    x = F.avg_pool2d(x, (1, side), 1, (0, side // 2), count_include_pad=False)
    return F.avg_pool2d(x, (side, 1), 1, (side // 2, 0), count_include_pad=False)


def scaled(detail: Tensor, floor: float) -> Tensor:
    """(B, C, h, w) details in units of four times their mean size over the image, at least `floor` grey levels."""
    spread = detail.abs().mean(dim=(1, 2, 3), keepdim=True).clamp_min(floor)
    return torch.clamp(detail / (4.0 * spread), -6.0, 6.0)
