"""SwinUnet: a Swin transformer that contracts, and one that expands patches again, joined level by level.

Source: Cao et al., Swin-Unet, 2022, figure 1.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from guide3d.modeling.swin_transformer import SwinStage, SwinTransformer


class PatchExpanding(nn.Module):
    """Spreads a token over `factor` x `factor` tokens."""

    def __init__(self, before: int, after: int, factor: int) -> None:
        """Args:
        factor: how many times as many tokens a side.
        """
        super().__init__()
        self.factor = factor
        self.expansion = nn.Linear(before, factor * factor * after, bias=False)
        self.norm = nn.LayerNorm(after)

    def forward(self, x: Tensor) -> Tensor:
        """(batch, h, w, before) to (batch, factor h, factor w, after)."""
        batch, height, width, _ = x.shape
        factor = self.factor
        x = self.expansion(x).reshape(batch, height, width, factor, factor, -1)
        result: Tensor = self.norm(x.transpose(2, 3).reshape(batch, factor * height, factor * width, -1))
        return result


class SwinUnet(nn.Module):
    """Images to logits of the wire."""

    def __init__(
        self,
        *,
        image_px: int,
        channels: int = 1,
        classes: int = 1,
        patch_px: int = 4,
        width: int = 96,
        depths: tuple[int, ...] = (2, 2, 2, 2),
        heads: tuple[int, ...] = (3, 6, 12, 24),
        window: int = 7,
    ) -> None:
        """Args:
        depths: blocks a stage, on the way down and again on the way up.
        """
        super().__init__()
        self.image_px, self.multiple_px = image_px, image_px
        self.encoder = SwinTransformer(
            image_px=image_px, channels=channels, patch_px=patch_px, width=width, depths=depths, heads=heads,
            window=window,
        )  # fmt: skip
        levels = range(len(depths) - 2, -1, -1)
        grid = image_px // patch_px
        self.expanding = nn.ModuleList(PatchExpanding(width * 2 ** (k + 1), width * 2**k, 2) for k in levels)
        self.joining = nn.ModuleList(nn.Linear(2 * width * 2**k, width * 2**k) for k in levels)
        self.stages = nn.ModuleList(SwinStage(width * 2**k, heads[k], window, grid // 2**k, depths[k]) for k in levels)
        self.norm = nn.LayerNorm(width)
        self.to_pixels = PatchExpanding(width, width, patch_px)
        self.head = nn.Conv2d(width, classes, 1, bias=False)

    def forward(self, images: Tensor) -> Tensor:
        """(batch, channels, image_px, image_px) to (batch, classes, image_px, image_px)."""
        *finer, x = self.encoder(images)
        for expand, join, stage, passed in zip(self.expanding, self.joining, self.stages, finer[::-1], strict=True):
            x = stage(join(torch.cat((expand(x), passed), dim=-1)))
        result: Tensor = self.head(self.to_pixels(self.norm(x)).permute(0, 3, 1, 2))
        return result
