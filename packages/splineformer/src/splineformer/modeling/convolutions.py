"""First layers of the ordered variant: local contrast and thin dark lines at several resolutions, then convolutions."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from guide3d.learning.precision import bfloat16_in_training

CHANNELS = 2
_COARSE = 8  # px whose mean is what local contrast is measured against
FLOOR = 0.25  # grey levels: an even picture's noise is not blown up further
_WAYS = ((0, 1), (1, 0), (1, 1), (1, -1))


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
        with bfloat16_in_training(self):
            for level in self.levels:
                x = level(x)
                maps.append(x.float())
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


def local_contrast(image: Tensor, floor: float = FLOOR) -> Tensor:
    """(B, 1, h, w) grey levels minus their local mean, in units of the picture's own detail: see `scaled`."""
    coarse = box_means(F.avg_pool2d(image, _COARSE), 3)
    around = F.interpolate(coarse, image.shape[-2:], mode="bilinear", align_corners=False)
    return scaled(image - around, floor)


def dark_lines(image: Tensor, reach: int, floor: float = FLOOR) -> Tensor:
    """How much darker each pixel is than what lies to both sides of it, in the direction where that is most.

    Edges are no lines: on one side of an edge it is dark.

    Args:
        image: (B, 1, h, w) grey levels.
        reach: px to each side.
        floor: see `scaled`.

    Returns:
        (B, 1, h, w), at least 0, in units of the picture's own lines.
    """
    height, width = image.shape[-2:]
    wide = F.pad(image, (reach,) * 4, mode="replicate")

    def moved(down: int, right: int) -> Tensor:
        top, left = reach + reach * down, reach + reach * right
        return wide[..., top : top + height, left : left + width]

    darker = image  # at least: what is no line is 0
    for down, right in _WAYS:
        darker = torch.maximum(darker, torch.minimum(moved(down, right), moved(-down, -right)))
    return scaled(darker - image, floor)


def _strongest_of_four(x: Tensor) -> Tensor:
    """What max pooling by 2 gives of (B, C, h, w), h and w even, in a tenth of its time on a processor."""
    x = torch.maximum(x[..., ::2, :], x[..., 1::2, :])
    return torch.maximum(x[..., ::2], x[..., 1::2])


def line_pyramid(image: Tensor, reach: int, levels: int, floor: float = FLOOR) -> list[Tensor]:
    """Contrast and lines at the picture's resolution, at half of it, and so on.

    Args:
        image: (B, 1, h, w) grey levels of 0 to 255.
        floor: see `scaled`.

    Returns:
        (B, 2, h / 2^k, w / 2^k) each; contrast is averaged on the way, of lines the strongest stay.
    """
    contrast, lines = local_contrast(image, floor), dark_lines(image, reach, floor)
    pyramid = [torch.cat([contrast, lines], 1)]
    for _ in range(levels - 1):
        contrast, lines = F.avg_pool2d(contrast, 2), _strongest_of_four(lines)
        pyramid.append(torch.cat([contrast, lines], 1))
    return pyramid
