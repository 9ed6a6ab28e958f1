"""Residual network with group normalisation and standardised convolutions: the front of TransUnet.

Source: Kolesnikov et al., Big Transfer, 2020 (bottlenecks as in He et al., 2016); Qiao et al., Weight
Standardization, 2019.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

_EPSILON = 1e-6


class StandardisedConvolution(nn.Conv2d):
    """A convolution whose filters have mean zero and variance one."""

    def forward(self, images: Tensor) -> Tensor:
        """(batch, before, h, w) to (batch, after, h', w')."""
        variance, mean = torch.var_mean(self.weight, dim=(1, 2, 3), keepdim=True, correction=0)
        weight = (self.weight - mean) * torch.rsqrt(variance + 1e-5)
        return functional.conv2d(images, weight, self.bias, self.stride, self.padding)


def _convolution(before: int, after: int, size: int, stride: int = 1) -> StandardisedConvolution:
    return StandardisedConvolution(before, after, size, stride=stride, padding=size // 2, bias=False)


def _groups(channels: int, wanted: int = 32) -> nn.GroupNorm:
    return nn.GroupNorm(min(wanted, channels), channels, eps=_EPSILON)


class Bottleneck(nn.Module):
    """1 x 1, 3 x 3 and 1 x 1 convolutions around which the input is carried."""

    def __init__(self, before: int, middle: int, after: int, stride: int) -> None:
        """Args:
        middle: of the 3 x 3 convolution.
        stride: of the 3 x 3 convolution.
        """
        super().__init__()
        self.body = nn.Sequential(
            _convolution(before, middle, 1), _groups(middle), nn.ReLU(),
            _convolution(middle, middle, 3, stride), _groups(middle), nn.ReLU(),
            _convolution(middle, after, 1), _groups(after),
        )  # fmt: skip
        self.carry: nn.Module = nn.Identity()
        if before != after or stride != 1:
            self.carry = nn.Sequential(_convolution(before, after, 1, stride), _groups(after, after))

    def forward(self, x: Tensor) -> Tensor:
        """(batch, before, h, w) to (batch, after, h / stride, w / stride)."""
        return functional.relu(self.carry(x) + self.body(x))


class ResidualNetwork(nn.Module):
    """Images to features at strides 2, 4, 8 and 16."""

    def __init__(self, *, channels: int = 1, width: int = 64, units: tuple[int, int, int] = (3, 4, 9)) -> None:
        """Args:
        width: of the root; its stages have 4, 8 and 16 times as many channels.
        """
        super().__init__()
        self.widths = (width, 4 * width, 8 * width, 16 * width)
        self.root = nn.Sequential(_convolution(channels, width, 7, 2), _groups(width), nn.ReLU())
        self.pool = nn.MaxPool2d(3, stride=2, padding=1)
        stages = []
        for stage, count in enumerate(units):
            before = width if stage == 0 else self.widths[stage]
            middle, after, stride = width * 2**stage, self.widths[stage + 1], 1 if stage == 0 else 2
            first: list[Any] = [Bottleneck(before, middle, after, stride)]
            stages.append(nn.Sequential(*first, *(Bottleneck(after, middle, after, 1) for _ in range(count - 1))))
        self.stages = nn.ModuleList(stages)

    def forward(self, images: Tensor) -> list[Tensor]:
        """(batch, channels, h, w) to features, the finest (h / 2) first, the coarsest (h / 16) last."""
        x = self.root(images)
        features = [x]
        x = self.pool(x)
        for stage in self.stages:
            x = stage(x)
            features.append(x)
        return features
