"""TransUnet: a residual network, a vision transformer on its coarsest features, and a cascaded upsampler.

Source: Chen et al., TransUNet, 2021, figure 1; sizes of R50-ViT-B/16.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from guide3d.modeling.vision_transformer import TransformerBlock

_EPSILON = 1e-6


STRIDE = 16  # of the transformer's tokens


class StandardisedConvolution(nn.Conv2d):
    """A convolution whose filters have mean zero and variance one."""

    def forward(self, images: Tensor) -> Tensor:
        """(batch, before, h, w) to (batch, after, h', w')."""
        variance, mean = torch.var_mean(self.weight, dim=(1, 2, 3), keepdim=True, correction=0)
        weight = (self.weight - mean) * torch.rsqrt(variance + 1e-5)
        return functional.conv2d(images, weight, self.bias, self.stride, self.padding)


def _convolution(before: int, after: int, size: int, stride: int = 1) -> StandardisedConvolution:
    return StandardisedConvolution(before, after, size, stride=stride, padding=size // 2, bias=False)


def _groups(channels: int, most: int = 32) -> nn.GroupNorm:
    return nn.GroupNorm(min(most, channels), channels, eps=_EPSILON)


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


def _decoder_convolution(before: int, after: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(before, after, 3, padding=1, bias=False), nn.BatchNorm2d(after), nn.ReLU())


class Upsampling(nn.Module):
    """Doubles the features, joins them with finer ones, and convolves twice."""

    def __init__(self, before: int, skipped: int, after: int) -> None:
        """Args:
        skipped: channels of the finer features; 0: there are none.
        """
        super().__init__()
        self.convolutions = nn.Sequential(
            _decoder_convolution(before + skipped, after), _decoder_convolution(after, after)
        )

    def forward(self, x: Tensor, finer: Tensor | None) -> Tensor:
        """(batch, before, h, w), (batch, skipped, 2 h, 2 w) to (batch, after, 2 h, 2 w)."""
        x = functional.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)
        result: Tensor = self.convolutions(x if finer is None else torch.cat((x, finer), dim=1))
        return result


class TransUnet(nn.Module):
    """Images to logits of the wire."""

    def __init__(
        self,
        *,
        image_px: int,
        channels: int = 1,
        classes: int = 1,
        residual_width: int = 64,
        residual_units: tuple[int, int, int] = (3, 4, 9),
        width: int = 768,
        depth: int = 12,
        heads: int = 12,
        hidden: int = 3072,
        dropout: float = 0.1,
        neck: int = 512,
        decoder: tuple[int, int, int, int] = (256, 128, 64, 16),
    ) -> None:
        """Args:
        image_px: side of the square image; a multiple of 16.
        """
        super().__init__()
        if image_px % STRIDE:
            raise ValueError(f"TransUnet takes images whose side is a multiple of {STRIDE} px, got {image_px}")
        self.image_px, self.multiple_px = image_px, STRIDE
        self.front = ResidualNetwork(channels=channels, width=residual_width, units=residual_units)
        skipped = self.front.widths
        self.embedding = nn.Conv2d(skipped[3], width, 1)
        self.positions = nn.Parameter(torch.zeros(1, (image_px // STRIDE) ** 2, width))
        nn.init.trunc_normal_(self.positions, std=0.02)
        self.dropout = nn.Dropout(dropout)
        self.blocks = nn.ModuleList(TransformerBlock(width, heads, hidden, dropout) for _ in range(depth))
        self.norm = nn.LayerNorm(width, eps=1e-6)
        self.neck = _decoder_convolution(width, neck)
        self.steps = nn.ModuleList(
            Upsampling(before, finer, after)
            for before, finer, after in zip(
                (neck, *decoder[:3]), (skipped[2], skipped[1], skipped[0], 0), decoder, strict=True
            )
        )
        self.head = nn.Conv2d(decoder[-1], classes, 3, padding=1)

    def forward(self, images: Tensor) -> Tensor:
        """(batch, channels, image_px, image_px) to (batch, classes, image_px, image_px)."""
        if images.shape[-2:] != (self.image_px, self.image_px):
            raise ValueError(f"expected images of {self.image_px} x {self.image_px} px, got {tuple(images.shape[-2:])}")
        stride2, stride4, stride8, coarsest = self.front(images)
        grid = coarsest.shape[-2:]
        tokens = self.dropout(self.embedding(coarsest).flatten(2).transpose(1, 2) + self.positions)
        for block in self.blocks:
            tokens = block(tokens)
        x = self.neck(self.norm(tokens).transpose(1, 2).unflatten(2, grid))
        for step, finer in zip(self.steps, (stride8, stride4, stride2, None), strict=True):
            x = step(x, finer)
        result: Tensor = self.head(x)
        return result
