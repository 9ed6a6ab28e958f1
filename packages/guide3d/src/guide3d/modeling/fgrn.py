"""3D-FGRN: one small image to points along the wire, by three convolutions and two fully connected layers."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from guide3d.learning.precision import bfloat16_in_training


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
