"""Shape network: frames of one camera to the wire in space, by a vision transformer, a GRU and three heads.

The heads tell the tip, the curve behind it (as spherical offsets of steps of a fixed radius, or its Cartesian twin: as
points relative to the tip), and at which of M positions it ends.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from guide3d.modeling.spherical import SphericalForm
from guide3d.modeling.vision_transformer import VisionTransformer

POOLINGS = ("class", "tokens")


class ImageFeatures(nn.Module):
    """An image to features z: a vision transformer, then a layer with GELU and one without."""

    def __init__(self, transformer: VisionTransformer, width: int, features: int, pooling: str, dropout: float) -> None:
        """Args:
        transformer: that sees the image.
        width: of its tokens.
        features: size of z.
        pooling: "class" takes the class token; "tokens" joins all patches, which keeps where things are.
        dropout: between the layers.
        """
        super().__init__()
        if pooling not in POOLINGS:
            raise ValueError(f"unknown pooling '{pooling}'; there are {', '.join(POOLINGS)}")
        self.transformer, self.pooling = transformer, pooling
        joined = width
        if pooling == "tokens":
            joined = width * transformer.grid**2
        self.projection = nn.Sequential(
            nn.Linear(joined, features), nn.GELU(), nn.Dropout(dropout), nn.Linear(features, features)
        )

    def forward(self, images: Tensor) -> Tensor:
        """(batch, channels, h, w) to (batch, features)."""
        tokens = self.transformer(images)
        seen = tokens[:, 0] if self.pooling == "class" else tokens[:, 1:].flatten(1)
        result: Tensor = self.projection(seen)
        return result


def _head(features: int, hidden: int, outputs: int, dropout: float) -> nn.Sequential:
    return nn.Sequential(nn.Linear(features, hidden), nn.GELU(), nn.Dropout(dropout), nn.Linear(hidden, outputs))


@dataclass
class PredictedShapes:
    """What the heads say of each window of frames.

    Attributes:
        tip_mm: (n, 3).
        offsets: (n, M - 1, 2) Δφ and Δθ in rad, or (n, M - 1, 3) mm relative to the tip.
        points_mm: (n, M, 3) the curve before it is cut.
        stop_logits: (n, M).
    """

    tip_mm: Tensor
    offsets: Tensor
    points_mm: Tensor
    stop_logits: Tensor


class ShapeNetwork(nn.Module):
    """Windows of frames to curves."""

    pixel_mean: Tensor
    pixel_scale: Tensor
    tip_mean: Tensor
    tip_scale: Tensor
    offset_mean: Tensor
    offset_scale: Tensor

    def __init__(
        self,
        features: ImageFeatures,
        form: SphericalForm | None,
        *,
        positions: int,
        size: int = 512,
        frames: int = 3,
        state: int = 512,
        hidden: int = 256,
        dropout: float = 0.1,
    ) -> None:
        """Args:
        features: of an image.
        form: how angles make a curve; None: the Cartesian twin.
        positions: M, points of the longest curve.
        size: of `features`.
        frames: of a window; the last is the one whose curve is told.
        state: of the GRU.
        hidden: units of a head.
        dropout: of heads, and between time steps.
        """
        super().__init__()
        self.features, self.form, self.frames, self.positions = features, form, frames, positions
        self.dropout = nn.Dropout(dropout)
        self.recurrent = nn.GRU(size, state, batch_first=True)
        self.columns = 3 if form is None else 2
        self.tip_head = _head(state, hidden, 3, dropout)
        self.offset_head = _head(state, hidden, self.columns * (positions - 1), dropout)
        self.stop_head = _head(state, hidden, positions, dropout)
        for name, value in (
            ("pixel_mean", torch.zeros(())), ("pixel_scale", torch.ones(())),
            ("tip_mean", torch.zeros(3)), ("tip_scale", torch.ones(3)),
            ("offset_mean", torch.zeros(positions - 1, self.columns)),
            ("offset_scale", torch.ones(positions - 1, self.columns)),
        ):  # fmt: skip
            self.register_buffer(name, value)

    def forward(self, clips: Tensor) -> PredictedShapes:
        """Tells the curves of a clip's windows.

        Args:
            clips: (batch, length, h, w) grey values of 0 to 255, in time order; length at least `frames`.

        Returns:
            One curve a window, (batch * (length - frames + 1)) of them, clip by clip.
        """
        batch, length = clips.shape[:2]
        if length < self.frames:
            raise ValueError(f"expected clips of at least {self.frames} frames, got {length}")
        images = (clips.flatten(0, 1)[:, None] - self.pixel_mean) / self.pixel_scale
        seen = self.features(images).unflatten(0, (batch, length))
        windows = seen.unfold(1, self.frames, 1).movedim(-1, 2).flatten(0, 1)
        _, last = self.recurrent(self.dropout(windows))
        state = last[0]
        tip = self.tip_mean + self.tip_scale * self.tip_head(state)
        offsets = self.offset_head(state).unflatten(1, (self.positions - 1, self.columns))
        # angles are summed up, which half precision does not bear
        offsets = self.offset_mean + self.offset_scale * offsets.float()
        tip = tip.float()
        if self.form is None:
            points = torch.cat((tip[:, None], tip[:, None] + offsets), dim=1)
        else:
            points = self.form.decode(tip, offsets)
        return PredictedShapes(tip, offsets, points, self.stop_head(state).float())

    @torch.no_grad()
    def curves(self, windows: Tensor) -> list[Tensor]:
        """Predicts the wires of windows of pictures, each cut where it most likely ends.

        Args:
            windows: (n, frames, h, w) grey values of 0 to 255.

        Returns:
            A curve a window, (m, 3) mm, world, tip first.
        """
        shapes = self(windows)
        ends = shapes.stop_logits.argmax(-1).clamp(min=1).tolist()
        return [points[: end + 1] for points, end in zip(shapes.points_mm, ends, strict=True)]
