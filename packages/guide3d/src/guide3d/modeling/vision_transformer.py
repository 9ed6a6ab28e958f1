"""Vision transformer: an image as a sequence of patches, each attending to all the others.

Source: Dosovitskiy et al., An Image is Worth 16x16 Words, 2021, section 3.1. Blocks normalise before attention and
feed-forward; positions are learnt.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from guide3d.learning.precision import attention


class SelfAttention(nn.Module):
    """Multi-head attention of a sequence to itself."""

    def __init__(self, width: int, heads: int) -> None:
        """Args:
        width: of a token; a multiple of `heads`.
        """
        super().__init__()
        if width % heads:
            raise ValueError(f"the width of a token must be a multiple of its heads, got {width} and {heads}")
        self.heads = heads
        self.query_key_value = nn.Linear(width, 3 * width)
        self.projection = nn.Linear(width, width)

    def forward(self, tokens: Tensor, bias: Tensor | None = None) -> Tensor:
        """(batch, n, width) to the same; a bias (batch or 1, heads, n, n) is added to the logits."""
        batch, count, width = tokens.shape
        packed = self.query_key_value(tokens).reshape(batch, count, 3, self.heads, width // self.heads)
        query, key, value = packed.permute(2, 0, 3, 1, 4)
        mixed = attention(query, key, value, bias)
        result: Tensor = self.projection(mixed.transpose(1, 2).reshape(batch, count, width))
        return result


class FeedForward(nn.Module):
    """Two layers applied to each token by itself."""

    def __init__(self, width: int, hidden: int, dropout: float = 0.0) -> None:
        super().__init__()
        self.expand = nn.Linear(width, hidden)
        self.contract = nn.Linear(hidden, width)
        self.dropout = nn.Dropout(dropout)

    def forward(self, tokens: Tensor) -> Tensor:
        """(batch, n, width) to the same."""
        result: Tensor = self.dropout(self.contract(self.dropout(functional.gelu(self.expand(tokens)))))
        return result


class TransformerBlock(nn.Module):
    """Attention, then feed-forward, each added to what came in."""

    def __init__(self, width: int, heads: int, hidden: int, dropout: float = 0.0) -> None:
        super().__init__()
        self.attention_norm = nn.LayerNorm(width, eps=1e-6)
        self.attention = SelfAttention(width, heads)
        self.feedforward_norm = nn.LayerNorm(width, eps=1e-6)
        self.feedforward = FeedForward(width, hidden, dropout)

    def forward(self, tokens: Tensor) -> Tensor:
        """(batch, n, width) to the same."""
        tokens = tokens + self.attention(self.attention_norm(tokens))
        result: Tensor = tokens + self.feedforward(self.feedforward_norm(tokens))
        return result


class _GroupNorm(nn.GroupNorm):
    """Group normalisation in float32: its way back in bfloat16 takes twice as long on a processor."""

    def forward(self, x: Tensor) -> Tensor:
        return super().forward(x.float()).to(x.dtype)


class ConvolutionalPatches(nn.Module):
    """Patches cut by a stack of stride-2 convolutions: it learns from few images what one large convolution does not.

    Source: Xiao et al., Early Convolutions Help Transformers See Better, 2021.
    """

    def __init__(self, channels: int, widths: tuple[int, ...], width: int) -> None:
        """Args:
        widths: of the convolutions; each halves the image.
        """
        super().__init__()
        layers: list[nn.Module] = []
        for before, after in zip((channels, *widths[:-1]), widths, strict=True):
            layers += [
                nn.Conv2d(before, after, 3, stride=2, padding=1, bias=False),
                _GroupNorm(max(1, after // 8), after),
                nn.ReLU(),
            ]
        self.layers = nn.Sequential(*layers, nn.Conv2d(widths[-1], width, 1))

    def forward(self, images: Tensor) -> Tensor:
        """(batch, channels, h, w) to (batch, width, h / 2^n, w / 2^n)."""
        result: Tensor = self.layers(images)
        return result


class VisionTransformer(nn.Module):
    """Images to tokens: the class token first, then one a patch, row by row."""

    def __init__(
        self,
        *,
        image_px: int,
        patch_px: int,
        channels: int,
        width: int,
        depth: int,
        heads: int,
        hidden: int,
        dropout: float = 0.0,
        stem: tuple[int, ...] = (),
    ) -> None:
        """Args:
        image_px: side of the square image; a multiple of `patch_px`.
        stem: widths of a convolutional stem that cuts the patches; empty: a single convolution does, as published.
        """
        super().__init__()
        if image_px % patch_px:
            raise ValueError(f"an image of {image_px} px does not divide into patches of {patch_px} px")
        if stem and 2 ** len(stem) != patch_px:
            raise ValueError(
                f"{len(stem)} convolutions of stride 2 make patches of {2 ** len(stem)} px, not {patch_px}"
            )
        self.image_px, self.grid = image_px, image_px // patch_px
        self.patches: nn.Module = (
            ConvolutionalPatches(channels, stem, width)
            if stem
            else nn.Conv2d(channels, width, patch_px, stride=patch_px)
        )
        self.class_token = nn.Parameter(torch.zeros(1, 1, width))
        self.positions = nn.Parameter(torch.zeros(1, 1 + self.grid**2, width))
        self.dropout = nn.Dropout(dropout)
        self.blocks = nn.ModuleList(TransformerBlock(width, heads, hidden, dropout) for _ in range(depth))
        self.norm = nn.LayerNorm(width, eps=1e-6)
        nn.init.trunc_normal_(self.class_token, std=0.02)
        nn.init.trunc_normal_(self.positions, std=0.02)

    def forward(self, images: Tensor) -> Tensor:
        """Encodes (batch, channels, image_px, image_px) images as (batch, 1 + patches, width) tokens."""
        if images.shape[-2:] != (self.image_px, self.image_px):
            raise ValueError(f"expected images of {self.image_px} x {self.image_px} px, got {tuple(images.shape[-2:])}")
        patches = self.patches(images).flatten(2).transpose(1, 2)
        tokens = torch.cat((self.class_token.expand(len(images), -1, -1), patches), dim=1)
        tokens = self.dropout(tokens + self.positions)
        for block in self.blocks:
            tokens = block(tokens)
        result: Tensor = self.norm(tokens)
        return result
