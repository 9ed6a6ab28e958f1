"""Encoder network: pictures and vectors to a bottleneck, from which a linear layer reads points of the wire."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from annotated_types import Interval
from torch import Tensor, nn
from torch.nn import functional

from enn.exploration import ARC_LENGTHS_MM, Samples
from enn.model_file import read_network, write_network
from enn.setting_kinds import Count, CountOrNone, LearningRate, Pixels, Seed, Units, Weight, settings

FORMAT = "enn-encoder-1"
POINTS = len(ARC_LENGTHS_MM)
TARGETS = 3 * POINTS + 3 + 3  # points, direction, force; and the numbers of the feeder
POINT_SCALE = 10.0  # mm
JOINT_LIKE = ("joints", "internal")  # their second number is the feeder's angle, which grows without end
WIRE_DARKNESS = 40.0  # grey levels by which the wire darkens an image, about
CLIP = 5.0  # standard deviations beyond which an input or a feature is cut off


@settings
class EncoderSettings:
    """Everything an encoder is built and trained from."""

    keys: tuple[str, ...] = ()  # observations that it sees; `fit_encoder` fills in keys, shapes and feeder
    shapes: tuple[tuple[Units, ...], ...] = ()
    feeder: Units = 3  # numbers of the observation `feeder`, which it learns to read; 7 with two devices
    pool: Pixels = 2  # side of the squares over which pictures are averaged first
    # Channels of the convolutions of 4 px that halve the picture; without any there are dense layers alone.
    channels: tuple[Units, ...] = ()
    hidden: Units = 256  # units of the layer after the convolutions, and of the MLP for vectors
    features: Units = 64
    epochs: CountOrNone = 0  # passes over the samples; 0: 10 with pictures, 30 without
    batch_size: Count = 64
    learning_rate: LearningRate = 2e-3  # highest one, of a cycle that rises and falls
    weight_decay: Weight = 1e-4  # of AdamW
    held_out: Annotated[float, Interval(gt=0, lt=1)] = 0.1  # share of the roll-outs for the test
    seed: Seed = 0

    def __post_init__(self) -> None:
        if len(self.keys) != len(self.shapes):
            raise ValueError(f"expected a shape for each of {len(self.keys)} keys, got {len(self.shapes)}")


class ImagePart(nn.Module):
    """Images of one size as channels: background removed, pooled, light convolutions if any, a dense layer."""

    background: Tensor
    gain: Tensor

    def __init__(self, channels: int, size: tuple[int, ...], settings: EncoderSettings) -> None:
        super().__init__()
        self.pool = settings.pool
        self.register_buffer("background", torch.zeros(channels, *size))
        self.register_buffer("gain", torch.ones(channels, 1, 1))
        layers: list[nn.Module] = []
        before = channels
        for width in settings.channels:
            layers += [nn.Conv2d(before, width, 4, 2, 1), nn.ReLU()]
            before = width
        body = nn.Sequential(*layers, nn.Flatten())
        with torch.no_grad():
            flat = body(self.prepare(torch.zeros(1, channels, *size))).shape[1]
        self.body = nn.Sequential(*body, nn.Linear(flat, settings.hidden), nn.ReLU())

    def prepare(self, pictures: Tensor) -> Tensor:
        """What no weight changes. Shapes (n, channels, height, width), and smaller by the pooling."""
        return functional.avg_pool2d((pictures - self.background) * self.gain, self.pool)

    def forward(self, prepared: Tensor) -> Tensor:
        """Shape (n, hidden)."""
        return self.body(prepared)


class VectorPart(nn.Module):
    """A vector: centred, scaled, cut off, two dense layers."""

    centre: Tensor
    scale: Tensor

    def __init__(self, size: int, settings: EncoderSettings, *, angle: bool) -> None:
        super().__init__()
        self.angle, hidden = angle, settings.hidden
        size += int(angle)
        self.register_buffer("centre", torch.zeros(size))
        self.register_buffer("scale", torch.ones(size))
        self.body = nn.Sequential(nn.Linear(size, hidden), nn.SiLU(), nn.Linear(hidden, hidden), nn.SiLU())

    def unwound(self, vector: Tensor) -> Tensor:
        """The feeder's angle as cosine and sine. Shape (n, size)."""
        vector = vector.flatten(1).float()
        if not self.angle:
            return vector
        angle = vector[:, 1:2]
        return torch.cat((vector[:, :1], angle.cos(), angle.sin(), vector[:, 2:]), dim=1)

    def prepare(self, vector: Tensor) -> Tensor:
        """What no weight changes. Shapes (n, ...) and (n, size)."""
        return ((self.unwound(vector) - self.centre) * self.scale).clamp(-CLIP, CLIP)

    def forward(self, prepared: Tensor) -> Tensor:
        """Shape (n, hidden)."""
        return self.body(prepared)


class Encoder(nn.Module):
    """Observations to features, from which a linear layer reads points of the wire.

    Raises:
        ValueError: there are no keys.
    """

    feature_mean: Tensor
    feature_scale: Tensor
    target_mean: Tensor

    def __init__(self, settings: EncoderSettings) -> None:
        super().__init__()
        if not settings.keys:
            raise ValueError("an encoder needs the keys and shapes of its observations: fit_encoder fills them in")
        self.settings, self.keys = settings, settings.keys
        self.groups: dict[str, tuple[str, ...]] = {}
        shapes = dict(zip(settings.keys, settings.shapes, strict=True))
        sizes: dict[tuple[int, ...], str] = {}
        for key, shape in shapes.items():
            name = sizes.setdefault(shape[1:], key) if len(shape) == 3 else key
            self.groups[name] = (*self.groups.get(name, ()), key)
        parts: dict[str, nn.Module] = {}
        for name, members in self.groups.items():
            if len(shapes[name]) == 3:
                channels = sum(shapes[member][0] for member in members)
                parts[name] = ImagePart(channels, shapes[name][1:], settings)
            else:
                parts[name] = VectorPart(int(np.prod(shapes[name])), settings, angle=name in JOINT_LIKE)
        self.parts = nn.ModuleDict(parts)
        self.trunk = nn.Sequential(
            nn.Linear(settings.hidden * len(parts), 128), nn.ReLU(), nn.Linear(128, settings.features)
        )
        self.head = nn.Linear(settings.features, TARGETS + settings.feeder)
        self.register_buffer("feature_mean", torch.zeros(settings.features))
        self.register_buffer("feature_scale", torch.ones(settings.features))
        self.register_buffer("target_mean", torch.zeros(TARGETS + settings.feeder))

    def _group(self, name: str, observations: Mapping[str, Tensor]) -> Tensor:
        members = self.groups[name]
        return observations[name] if len(members) == 1 else torch.cat([observations[key] for key in members], dim=1)

    def prepare(self, observations: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """What no weight changes, by the name of the part that takes it."""
        parts: Any = self.parts
        return {name: part.prepare(self._group(name, observations)) for name, part in parts.items()}

    def bottleneck(self, prepared: Mapping[str, Tensor]) -> Tensor:
        """Features before normalisation. Shape (n, features)."""
        return self.trunk(torch.cat([part(prepared[name]) for name, part in self.parts.items()], dim=1))

    def forward(self, observations: Mapping[str, Tensor]) -> Tensor:
        """Features of zero mean and unit variance over the samples.

        Args:
            observations: as the environment gives them, pictures as bytes; other keys are ignored. Shapes (n, ...).

        Returns:
            Shape (n, features).
        """
        return ((self.bottleneck(self.prepare(observations)) - self.feature_mean) * self.feature_scale).clamp(
            -CLIP, CLIP
        )

    def wire_points_mm(self, observations: Mapping[str, Tensor]) -> Tensor:
        """Wire points at `ARC_LENGTHS_MM` behind the tip, mm, world frame. Shape (n, points, 3)."""
        values = self.head(self.bottleneck(self.prepare(observations))) + self.target_mean
        return POINT_SCALE * values[:, : 3 * POINTS].unflatten(1, (POINTS, 3))

    @torch.no_grad()
    def adapt(self, samples: Samples) -> None:
        """Sets what is subtracted and scaled in the inputs from samples."""
        some = np.linspace(0, len(samples) - 1, min(len(samples), 400)).astype(int)
        for name, part in self.parts.items():
            if isinstance(part, VectorPart):
                values = torch.from_numpy(samples.observations[name])
                unwound = part.unwound(values)
                spread = unwound.std(0, correction=0)
                part.centre.copy_(unwound.mean(0))
                # a number that hardly moves tells nothing, and its noise is not to be blown up
                part.scale.copy_(torch.where(spread > 1e-6, 1.0 / spread.clamp(min=1e-4), torch.zeros(())))
            elif isinstance(part, ImagePart):
                backgrounds, gains = [], []
                for key in self.groups[name]:
                    frames = samples.observations[key][some]
                    # the wire darkens: bright values of a pixel are those without it; in a mask, that is 0
                    is_mask = key.startswith("mask")
                    background = np.zeros(frames.shape[1:]) if is_mask else np.quantile(frames, 0.95, axis=0)
                    backgrounds.append(torch.from_numpy(background.astype(np.float32)))
                    gains += [1.0 / 255.0 if is_mask else -1.0 / WIRE_DARKNESS] * len(background)
                part.background.copy_(torch.cat(backgrounds))
                part.gain.copy_(torch.tensor(gains)[:, None, None])

    def save(self, path: Path | str) -> None:
        """Writes settings and weights into one file, atomically."""
        write_network(path, FORMAT, self)

    @classmethod
    def load(cls, path: Path | str, device: torch.device | str = "cpu") -> Encoder:
        """Reads an encoder onto a device, frozen and in evaluation mode.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: it is damaged, no encoder, or its weights do not fit its settings.
        """
        encoder, _ = read_network(
            path,
            FORMAT,
            lambda settings: cls(EncoderSettings(**settings)),
            kind="encoder",
            verb="fit",
            device=device,
        )
        encoder.eval().requires_grad_(False)
        return encoder
