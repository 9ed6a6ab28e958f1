"""UNet: a contracting and an expanding path of convolutions, joined level by level.

Source: Ronneberger et al., U-Net, 2015, figure 1. Convolutions are padded, so that the mask is as large as the image;
the paper's are not, and its parameters are the same.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn


def normalisation(kind: str, channels: int) -> nn.Module:
    """A layer of normalisation: "none" (as in the paper) or "batch"."""
    if kind == "none":
        return nn.Identity()
    if kind == "batch":
        return nn.BatchNorm2d(channels)
    raise ValueError(f"unknown normalisation '{kind}'; there are none, batch")


class DoubleConvolution(nn.Sequential):
    """Two 3 x 3 convolutions, each followed by a rectifier."""

    def __init__(self, before: int, after: int, kind: str) -> None:
        layers: list[nn.Module] = []
        for channels in (before, after):
            layers += [
                nn.Conv2d(channels, after, 3, padding=1, bias=kind == "none"),
                normalisation(kind, after),
                nn.ReLU(),
            ]
        super().__init__(*layers)


class UNet(nn.Module):
    """Images to logits of the wire."""

    def __init__(
        self, *, channels: int = 1, classes: int = 1, widths: tuple[int, ...] = (64, 128, 256, 512, 1024),
        kind: str = "none",
    ) -> None:  # fmt: skip
        """Args:
        widths: channels of the levels, the finest first.
        kind: of normalisation, see `normalisation`.
        """
        super().__init__()
        self.multiple_px = 2 ** (len(widths) - 1)
        self.down = nn.ModuleList(
            DoubleConvolution(before, after, kind) for before, after in zip((channels, *widths), widths, strict=False)
        )
        self.pool = nn.MaxPool2d(2)
        pairs = list(zip(widths[:0:-1], widths[-2::-1], strict=True))
        self.up = nn.ModuleList(nn.ConvTranspose2d(coarse, fine, 2, stride=2) for coarse, fine in pairs)
        self.join = nn.ModuleList(DoubleConvolution(2 * fine, fine, kind) for _, fine in pairs)
        self.head = nn.Conv2d(widths[0], classes, 1)

    def forward(self, images: Tensor) -> Tensor:
        """(batch, channels, h, w) to (batch, classes, h, w); h and w multiples of `multiple_px`."""
        passed = []
        x = images
        for level, convolutions in enumerate(self.down):
            x = convolutions(x if level == 0 else self.pool(x))
            passed.append(x)
        for up, join, finer in zip(self.up, self.join, passed[-2::-1], strict=True):
            x = join(torch.cat((finer, up(x)), dim=1))
        result: Tensor = self.head(x)
        return result
