"""TransUnet: a residual network, a vision transformer on its coarsest features, and a cascaded upsampler.

Source: Chen et al., TransUNet, 2021, figure 1; sizes of R50-ViT-B/16.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from guide3d.modeling.resnet import ResidualNetwork
from guide3d.modeling.vision_transformer import TransformerBlock

STRIDE = 16  # of the transformer's tokens


def _convolution(before: int, after: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(before, after, 3, padding=1, bias=False), nn.BatchNorm2d(after), nn.ReLU())


class Upsampling(nn.Module):
    """Doubles the features, joins them with finer ones, and convolves twice."""

    def __init__(self, before: int, skipped: int, after: int) -> None:
        """Args:
        skipped: channels of the finer features; 0: there are none.
        """
        super().__init__()
        self.convolutions = nn.Sequential(_convolution(before + skipped, after), _convolution(after, after))

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
        self.neck = _convolution(width, neck)
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
