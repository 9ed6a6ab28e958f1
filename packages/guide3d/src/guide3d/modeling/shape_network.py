"""Shape network: frames of one camera to the wire in space, by a vision transformer, a GRU and three heads.

The heads tell the tip, the curve (as spherical offsets of steps of a fixed radius, or its Cartesian twin: as points
relative to where it is anchored), and at which of M positions it ends. Published curves are anchored at the tip. The
other anchor is where the wire enters the image: from there on all wires of a patient run alike for most of their way,
so that a position means the same place in the vessel in every frame, and what differs between frames is the rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from guide3d.learning.precision import bfloat16_in_training
from guide3d.modeling.spherical import SphericalForm
from guide3d.modeling.vision_transformer import VisionTransformer

POOLINGS = ("class", "tokens")
ANCHORS = ("tip", "entry")


class ImageFeatures(nn.Module):
    """An image to features z: a vision transformer, then a layer with GELU and one without."""

    def __init__(
        self, transformer: VisionTransformer, width: int, features: int, pooling: str, dropout: float, kept: int = 0
    ) -> None:
        """Args:
        pooling: "class" takes the class token; "tokens" joins all patches, which keeps where things are.
        kept: numbers that "tokens" keeps of each patch; 0: all.
        """
        super().__init__()
        if pooling not in POOLINGS:
            raise ValueError(f"unknown pooling '{pooling}'; there are {', '.join(POOLINGS)}")
        self.transformer, self.pooling = transformer, pooling
        joined = width
        self.narrow: nn.Module = nn.Identity()
        if pooling == "tokens":
            joined = (kept or width) * transformer.grid**2
            if kept:
                self.narrow = nn.Linear(width, kept)
        self.projection = nn.Sequential(
            nn.Linear(joined, features), nn.GELU(), nn.Dropout(dropout), nn.Linear(features, features)
        )

    def forward(self, images: Tensor) -> Tensor:
        """(batch, channels, h, w) to (batch, features)."""
        with bfloat16_in_training(self):
            tokens = self.transformer(images)
            seen = tokens[:, 0] if self.pooling == "class" else self.narrow(tokens[:, 1:]).flatten(1)
            result: Tensor = self.projection(seen)
        return result.float()


def _head(features: int, hidden: int, outputs: int, dropout: float) -> nn.Sequential:
    return nn.Sequential(nn.Linear(features, hidden), nn.GELU(), nn.Dropout(dropout), nn.Linear(hidden, outputs))


@dataclass
class PredictedShapes:
    """What the heads say of each window of frames.

    Attributes:
        tip_mm: (n, 3).
        offsets: (n, M - 1, 2) Δφ and Δθ in rad, or (n, M - 1, 3) mm relative to the anchor; from the anchor on.
        points_mm: (n, M, 3) the curve before it is cut, from the anchor on.
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
    entry_mean: Tensor
    entry_scale: Tensor
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
        anchor: str = "tip",
    ) -> None:
        """Args:
        form: how angles make a curve; None: the Cartesian twin.
        positions: M, points of the longest curve.
        size: of `features`.
        frames: of a window; the last is the one whose curve is predicted.
        anchor: of `ANCHORS`.
        """
        super().__init__()
        if anchor not in ANCHORS:
            raise ValueError(f"unknown anchor '{anchor}'; there are {', '.join(ANCHORS)}")
        if anchor == "entry" and form is not None and form.cumulative:
            raise ValueError("offsets from step to step begin at the tip: they have no anchor where the wire enters")
        self.anchor = anchor
        self.features, self.form, self.frames, self.positions = features, form, frames, positions
        self.dropout = nn.Dropout(dropout)
        self.recurrent = nn.GRU(size, state, batch_first=True)
        self.columns = 3 if form is None else 2
        self.tip_head = _head(state, hidden, 3, dropout)
        self.offset_head = _head(state, hidden, self.columns * (positions - 1), dropout)
        self.stop_head = _head(state, hidden, positions, dropout)
        if anchor == "entry":
            self.entry_head = _head(state, hidden, 3, dropout)
        for name, value in (
            ("pixel_mean", torch.zeros(())), ("pixel_scale", torch.ones(())),
            ("tip_mean", torch.zeros(3)), ("tip_scale", torch.ones(3)),
            ("entry_mean", torch.zeros(3)), ("entry_scale", torch.ones(3)),
            ("offset_mean", torch.zeros(positions - 1, self.columns)),
            ("offset_scale", torch.ones(positions - 1, self.columns)),
        ):  # fmt: skip
            self.register_buffer(name, value)

    def forward(self, clips: Tensor, last: Tensor | None = None) -> PredictedShapes:
        """Tells the curves of a clip's windows.

        Args:
            clips: (batch, length, h, w) grey values of 0 to 255, in time order; length at least `frames`.
            last: (windows,) positions at which the curves are known to end; None: where the network ends them.

        Returns:
            One curve a window, (batch * (length - frames + 1)) of them, clip by clip.
        """
        batch, length = clips.shape[:2]
        if length < self.frames:
            raise ValueError(f"expected clips of at least {self.frames} frames, got {length}")
        images = (clips.flatten(0, 1)[:, None] - self.pixel_mean) / self.pixel_scale
        seen = self.features(images).unflatten(0, (batch, length))
        windows = seen.unfold(1, self.frames, 1).movedim(-1, 2).flatten(0, 1)
        _, states = self.recurrent(self.dropout(windows))
        state = states[0]
        tip = self.tip_mean + self.tip_scale * self.tip_head(state)
        offsets = self.offset_head(state).unflatten(1, (self.positions - 1, self.columns))
        # angles are summed up, which half precision does not bear
        offsets = self.offset_mean + self.offset_scale * offsets.float()
        tip, stop = tip.float(), self.stop_head(state).float()
        if self.anchor == "tip":
            anchor, away = tip, 1.0
        else:
            anchor, away = self.entry_mean + self.entry_scale * self.entry_head(state).float(), -1.0
        way = offsets if self.form is None else away * self.form.steps(offsets).cumsum(dim=-2)
        points = torch.cat((anchor[:, None], anchor[:, None] + way), dim=1)
        if self.anchor == "entry" and self.form is not None:
            points = closed(points, tip, self.ends(stop) if last is None else last)
        return PredictedShapes(tip, offsets, points, stop)

    def ends(self, stop_logits: Tensor) -> Tensor:
        """(n,) positions at which curves end, of (n, M) logits: the likeliest, or that of the mean length.

        A curve that is anchored where it enters is led to its tip, so its length only stretches it: the mean errs
        least.
        """
        if self.anchor == "tip":
            return stop_logits.argmax(-1).clamp(min=1)
        return expected_position(stop_logits).round().long().clamp(min=1)

    @torch.no_grad()
    def curves(self, windows: Tensor) -> list[Tensor]:
        """Predicts the wires of windows of pictures (n, frames, h, w) of 0 to 255, each cut where it most likely ends.

        Returns:
            A curve a window, (m, 3) mm, world, tip first.
        """
        shapes = self(windows)
        ends = self.ends(shapes.stop_logits).tolist()
        curves = [points[: end + 1] for points, end in zip(shapes.points_mm, ends, strict=True)]
        return curves if self.anchor == "tip" else [curve.flip(0) for curve in curves]


def expected_position(stop_logits: Tensor) -> Tensor:
    """(n, M) logits to the (n,) means of the positions under them."""
    positions = torch.arange(stop_logits.shape[-1], dtype=stop_logits.dtype, device=stop_logits.device)
    return stop_logits.softmax(-1) @ positions


def closed(points_mm: Tensor, tip_mm: Tensor, last: Tensor) -> Tensor:
    """Leads curves to their tips: each point moves by its share of the way, as surveyors close a traverse.

    Args:
        points_mm: (n, M, 3) from the anchor on.
        tip_mm: (n, 3).
        last: (n,) positions that are the tips.
    """
    gap = tip_mm - points_mm.gather(1, last[:, None, None].expand(-1, 1, 3))[:, 0]
    positions = torch.arange(points_mm.shape[1], dtype=points_mm.dtype, device=points_mm.device)
    share = (positions / last[:, None]).clamp(max=1.0)
    return points_mm + share[..., None] * gap[:, None]


class FGRN(nn.Module):
    """Images to a fixed number of points, tip first."""

    pixel_mean: Tensor
    pixel_scale: Tensor
    point_mean: Tensor
    point_scale: Tensor

    def __init__(
        self,
        *,
        points: int,
        image_px: int = 80,
        filters: tuple[int, ...] = (32, 64, 128),
        hidden: tuple[int, ...] = (256, 128),
        dropout: float = 0.3,
    ) -> None:
        """Args:
        filters: of the 3 x 3 convolutions; each is followed by a rectifier and 2 x 2 max pooling.
        hidden: units of the fully connected layers; each is followed by a rectifier and dropout.
        """
        super().__init__()
        self.points, self.image_px = points, image_px
        layers: list[nn.Module] = []
        for before, after in zip((1, *filters), filters, strict=False):
            layers += [nn.Conv2d(before, after, 3, padding=1), nn.ReLU(), nn.MaxPool2d(2)]
        side = image_px // 2 ** len(filters)
        units = filters[-1] * side**2
        layers.append(nn.Flatten())
        for count in hidden:
            layers += [nn.Linear(units, count), nn.ReLU(), nn.Dropout(dropout)]
            units = count
        self.layers = nn.Sequential(*layers, nn.Linear(units, 3 * points))
        for name, value in (
            ("pixel_mean", torch.zeros(())), ("pixel_scale", torch.ones(())),
            ("point_mean", torch.zeros(points, 3)), ("point_scale", torch.ones(())),
        ):  # fmt: skip
            self.register_buffer(name, value)

    def forward(self, images: Tensor) -> Tensor:
        """(batch, image_px, image_px) grey values of 0 to 255 to (batch, points, 3) mm."""
        if images.shape[-2:] != (self.image_px, self.image_px):
            raise ValueError(f"expected images of {self.image_px} x {self.image_px} px, got {tuple(images.shape[-2:])}")
        with bfloat16_in_training(self):
            seen = self.layers[:-1]((images[:, None] - self.pixel_mean) / self.pixel_scale)
        points: Tensor = self.layers[-1](seen.float())
        return self.point_mean + self.point_scale * points.float().unflatten(1, (self.points, 3))
