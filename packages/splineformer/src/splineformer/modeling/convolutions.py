"""Convolutional parts of the parallel variant: a stem that halves the image again and again, and the way back up."""

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


class Ascent(nn.Module):
    """From coarse to fine: what is known of the whole image joins what is known of each place.

    Args:
        coarse: channels of the coarsest map.
        channels: of the finer maps, coarse to fine.
    """

    def __init__(self, coarse: int, channels: Sequence[int]) -> None:
        super().__init__()
        self.narrow, self.mix = nn.ModuleList(), nn.ModuleList()
        for after in channels:
            self.narrow.append(nn.Conv2d(coarse, after, 1))
            self.mix.append(convolution(after, after))
            coarse = after

    def forward(self, x: Tensor, finer: Sequence[Tensor]) -> list[Tensor]:
        """The coarsest map and the finer ones, coarse to fine, to one map a level."""
        maps = []
        for narrow, mix, detail in zip(self.narrow, self.mix, finer, strict=True):
            x = mix(F.interpolate(narrow(x), scale_factor=2.0, mode="bilinear", align_corners=False) + detail)
            maps.append(x)
        return maps


def box_means(x: Tensor, side: int) -> Tensor:
    """Means over square neighbourhoods of odd side; at the border over what lies inside."""
    return F.avg_pool2d(x, side, 1, side // 2, count_include_pad=False)


def local_contrast(image: Tensor, side: int) -> Tensor:
    """(B, 1, h, w) grey levels minus their local mean, in local standard deviations of the whole image's detail."""
    detail = image - box_means(image, side)
    spread = detail.abs().mean(dim=(1, 2, 3), keepdim=True).clamp_min(0.25)
    return torch.clamp(detail / (4.0 * spread), -6.0, 6.0)
