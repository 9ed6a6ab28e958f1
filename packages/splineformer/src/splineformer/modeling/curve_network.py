"""What every variant is to the rest of the package: a network that reads a batch of images as curves."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor, nn

from guide3d.geometry.polyline import Array

WIRES = ("none", "one", "several")


class ImageKind(NamedTuple):
    """Logits about an image."""

    wires: Tensor  # (B, 3) of WIRES
    inverted: Tensor  # (B,)


class ImageHead(nn.Module):
    """Two linear maps on the mean and the maximum of the encoder's features."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.hidden = nn.Sequential(nn.Linear(2 * width, width), nn.GELU())
        self.wires, self.inverted = nn.Linear(width, len(WIRES)), nn.Linear(width, 1)

    def forward(self, features: Tensor) -> ImageKind:
        """(B, N, width) features to logits."""
        hidden = self.hidden(torch.cat([features.mean(dim=1), features.amax(dim=1)], dim=-1))
        return ImageKind(self.wires(hidden), self.inverted(hidden)[:, 0])


class CurveBatch(NamedTuple):
    """Curves that a network read off images."""

    tokens: Tensor  # (B, limit, 3) knot, x, y: knots of any scale, x and y as shares of the image's side
    lengths: Tensor  # (B,) tokens of each curve, at least four
    features: Tensor  # (B, N, width) output of the encoder, N = side² cells row by row
    kind: ImageKind
    quality: Tensor  # (B,) 0 to 1, of the curve, given that there is one
    error: Tensor | None  # (B,) expected mean distance of the curve, shares of the side; None: not estimated

    def unit_tokens(self) -> Tensor:
        """(B, limit, 3) tokens with ascending knots of 0 to 1; a shorter curve is continued by its last token."""
        place = torch.arange(self.tokens.shape[1], device=self.tokens.device)[None]
        last = torch.minimum(place, (self.lengths - 1)[:, None])
        tokens = self.tokens.gather(1, last[..., None].expand(-1, -1, 3))
        knots = torch.cummax(tokens[..., :1].clamp_min(0), 1).values
        return torch.cat([knots / knots[:, -1:].clamp_min(1e-6), tokens[..., 1:]], -1)


class CurveNetwork(nn.Module, ABC):
    """Images to curves as spline tokens.

    Attributes:
        variant: name under which `splineformer.build` knows it.
        settings: sizes; all variants have ``image_px`` and ``width``.
        kind: says what the image shows.
    """

    variant: ClassVar[str]
    settings: Any
    kind: ImageHead

    @property
    @abstractmethod
    def limit(self) -> int:
        """Most tokens of a curve."""

    @abstractmethod
    def read(self, image: Tensor) -> CurveBatch:
        """Reads the curves off (B, 1, image_px, image_px) grey levels of 0 to 255; without gradients."""

    def read_again(self, image: Tensor, curves: Tensor) -> CurveBatch | None:
        """Reads pictures, beginning near curves (B, n, 2) that were found in them; None where a variant cannot.

        Args:
            curves: points at equal arc length, tip first, shares of the side.
        """
        return None

    @abstractmethod
    def attention(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """The last decoder layer's attention to the encoder's features.

        Returns:
            (B, heads, tokens, N) weights, which sum to one over the N cells, and (B,) how many of the tokens count.
        """

    @abstractmethod
    def fit_tokens(self, points_px: Array) -> Array:
        """Fits (n, 3) tokens of the variant's own form, px, to a polyline of (m, 2) px, tip first."""
