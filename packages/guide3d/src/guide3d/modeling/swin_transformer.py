"""Swin transformer: attention inside windows that shift from block to block, patches merged from stage to stage.

Source: Liu et al., Swin Transformer, 2021, section 3. Features are (batch, h, w, width) throughout.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from guide3d.modeling.vision_transformer import FeedForward, SelfAttention

# Added to logits of pairs that a shift has brought into one window. exp(-100) would be denormal, with which products of
# matrices take twelve times as long.
_MASKED = -1000.0


class WindowAttention(SelfAttention):
    """Attention inside a window, with a learnt bias for each relative position."""

    bias_index: Tensor

    def __init__(self, width: int, heads: int, window: int) -> None:
        super().__init__(width, heads)
        self.bias_table = nn.Parameter(torch.zeros((2 * window - 1) ** 2, heads))
        nn.init.trunc_normal_(self.bias_table, std=0.02)
        rows, columns = torch.meshgrid(torch.arange(window), torch.arange(window), indexing="ij")
        places = torch.stack((rows.flatten(), columns.flatten()), dim=1)
        apart = places[:, None] - places[None] + window - 1
        self.register_buffer("bias_index", apart[..., 0] * (2 * window - 1) + apart[..., 1], persistent=False)

    def forward(self, tokens: Tensor, mask: Tensor | None = None) -> Tensor:
        """Attends within windows; gives the tokens' shape.

        Args:
            tokens: (images * windows, n, width).
            mask: (windows, n, n) added to the logits, or None.
        """
        bias = self.bias_table[self.bias_index].permute(2, 0, 1)[None]
        if mask is not None:
            bias = (bias + mask[:, None]).repeat(len(tokens) // len(mask), 1, 1, 1)
        return super().forward(tokens, bias)


class SwinBlock(nn.Module):
    """Attention in windows, shifted by half a window in every other block, then feed-forward."""

    mask: Tensor | None

    def __init__(self, width: int, heads: int, window: int, grid: int, *, shifted: bool) -> None:
        """Args:
        grid: tokens a side of the whole image; a multiple of the window, or smaller.
        shifted: whether the windows are; never where one window is the whole image.
        """
        super().__init__()
        self.window = min(window, grid)
        if grid % self.window:
            raise ValueError(f"{grid} tokens a side do not divide into windows of {self.window}")
        self.shift = self.window // 2 if shifted and grid > self.window else 0
        self.attention_norm = nn.LayerNorm(width)
        self.attention = WindowAttention(width, heads, self.window)
        self.feedforward_norm = nn.LayerNorm(width)
        self.feedforward = FeedForward(width, 4 * width)
        self.register_buffer(
            "mask", _shift_mask(grid, self.window, self.shift) if self.shift else None, persistent=False
        )

    def forward(self, x: Tensor) -> Tensor:
        """(batch, grid, grid, width) to the same."""
        inside = self.attention_norm(x)
        if self.shift:
            inside = inside.roll((-self.shift, -self.shift), dims=(1, 2))
        windows = _cut(inside, self.window)
        attended = _paste(self.attention(windows, self.mask), self.window, x.shape)
        if self.shift:
            attended = attended.roll((self.shift, self.shift), dims=(1, 2))
        x = x + attended
        result: Tensor = x + self.feedforward(self.feedforward_norm(x))
        return result


def _cut(x: Tensor, window: int) -> Tensor:
    batch, height, width, channels = x.shape
    x = x.reshape(batch, height // window, window, width // window, window, channels)
    return x.transpose(2, 3).reshape(-1, window * window, channels)


def _paste(windows: Tensor, window: int, shape: torch.Size) -> Tensor:
    batch, height, width, channels = shape
    x = windows.reshape(batch, height // window, width // window, window, window, channels)
    return x.transpose(2, 3).reshape(batch, height, width, channels)


def _shift_mask(grid: int, window: int, shift: int) -> Tensor:
    part = torch.zeros(grid)
    part[-window:-shift], part[-shift:] = 1, 2
    regions = (3 * part[:, None] + part[None]).reshape(1, grid, grid, 1)
    labels = _cut(regions, window).squeeze(-1)
    return torch.where(labels[:, :, None] == labels[:, None], 0.0, _MASKED)


class PatchMerging(nn.Module):
    """Joins 2 x 2 tokens into one of twice the width."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(4 * width)
        self.reduction = nn.Linear(4 * width, 2 * width, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        """(batch, h, w, width) to (batch, h / 2, w / 2, 2 width)."""
        four = [x[:, row::2, column::2] for column in (0, 1) for row in (0, 1)]
        result: Tensor = self.reduction(self.norm(torch.cat(four, dim=-1)))
        return result


class SwinStage(nn.Sequential):
    """Blocks of one resolution, shifted in turn."""

    def __init__(self, width: int, heads: int, window: int, grid: int, depth: int) -> None:
        super().__init__(*(SwinBlock(width, heads, window, grid, shifted=bool(k % 2)) for k in range(depth)))


class SwinTransformer(nn.Module):
    """Images to features of every stage."""

    def __init__(
        self,
        *,
        image_px: int,
        channels: int = 1,
        patch_px: int = 4,
        width: int = 96,
        depths: tuple[int, ...] = (2, 2, 6, 2),
        heads: tuple[int, ...] = (3, 6, 12, 24),
        window: int = 7,
    ) -> None:
        """Args:
        image_px: side of the square image; its tokens divide into windows at every stage.
        """
        super().__init__()
        if image_px % (patch_px * 2 ** (len(depths) - 1)):
            raise ValueError(
                f"an image of {image_px} px cannot be halved {len(depths) - 1} times from patches of {patch_px}"
            )
        self.image_px = image_px
        self.patches = nn.Conv2d(channels, width, patch_px, stride=patch_px)
        self.patch_norm = nn.LayerNorm(width)
        grid = image_px // patch_px
        self.stages = nn.ModuleList(
            SwinStage(width * 2**k, heads[k], window, grid // 2**k, depth) for k, depth in enumerate(depths)
        )
        self.merging = nn.ModuleList(PatchMerging(width * 2**k) for k in range(len(depths) - 1))
        self.norm = nn.LayerNorm(width * 2 ** (len(depths) - 1))

    def forward(self, images: Tensor) -> list[Tensor]:
        """(batch, channels, image_px, image_px) to (batch, h, w, width), the finest first; the last is normalised."""
        if images.shape[-2:] != (self.image_px, self.image_px):
            raise ValueError(f"expected images of {self.image_px} x {self.image_px} px, got {tuple(images.shape[-2:])}")
        x = self.patch_norm(self.patches(images).permute(0, 2, 3, 1))
        features = []
        for k, stage in enumerate(self.stages):
            x = stage(x)
            features.append(x)
            if k < len(self.merging):
                x = self.merging[k](x)
        features[-1] = self.norm(features[-1])
        return features


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
