"""Image networks: convolutions over one or several grey images, as what learns from expert episodes uses them."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from enn.networks.features import thesis_cnn
from enn.setting_kinds import Pixels, Units, settings

VARIANTS = ("thesis", "desk")
DESK_CHANNELS = (16, 32, 48, 64)
# A wire's pixel differs from the mean image by some tens of grey values: this brings it to about one.
CONTRAST = 20.0


@settings
class ImageSettings:
    """What shapes of weights depend on."""

    shape: tuple[Units, Pixels, Pixels] = (1, 80, 80)  # channels, height, width of the input
    # "thesis", the network of its tables on intensities of 0 to 1; or "desk", a lighter one on the difference to the
    # mean training image
    variant: str = "desk"
    features: Units = 128  # at the network's end; the thesis's table says 128

    def __post_init__(self) -> None:
        if self.variant not in VARIANTS:
            raise ValueError(f"unknown variant '{self.variant}'; there are {', '.join(VARIANTS)}")
        if min(self.shape[1:]) < 36:
            raise ValueError(f"images need a shape (channels, height, width) of at least 36 px, got {self.shape}")


class ImageNetwork(nn.Module):
    """Images (N, channels, height, width) of uint8 to features (N, features), which are not negative."""

    background: Tensor

    def __init__(self, settings: ImageSettings) -> None:
        super().__init__()
        self.settings = settings
        self.register_buffer("background", torch.zeros(settings.shape))
        if settings.variant == "thesis":
            self.layers = thesis_cnn(settings.shape, settings.features)
        else:
            convolutions = nn.Sequential(*_desk(settings.shape[0]))
            with torch.no_grad():
                flat = convolutions(torch.zeros(1, *settings.shape)).shape[1]
            self.layers = nn.Sequential(
                *convolutions, nn.Linear(flat, 256), nn.ReLU(), nn.Linear(256, settings.features), nn.ReLU()
            )

    def fit_background(self, images: Tensor) -> None:
        """Takes the mean image of the training samples as background; the thesis's variant has none.

        Args:
            images: (N, channels, height, width) uint8.
        """
        if self.settings.variant == "desk":
            total = sum(part.sum(0, dtype=torch.float64) for part in images.split(1024))
            self.background.copy_(torch.as_tensor(total / len(images)))

    def forward(self, images: Tensor) -> Tensor:
        """Features of images. Shape (N, features)."""
        if self.settings.variant == "thesis":
            scaled = images.float() / 255.0
        else:
            scaled = (images.float() - self.background) / CONTRAST
        features: Tensor = self.layers(scaled)
        return features


def _desk(channels: int) -> list[nn.Module]:
    layers: list[nn.Module] = []
    for index, width in enumerate(DESK_CHANNELS):
        kernel = 5 if index == 0 else 3
        layers += [nn.Conv2d(channels, width, kernel, 2, kernel // 2), nn.ReLU()]
        channels = width
    return [*layers, nn.Flatten()]


def shifted(images: Tensor, offsets: Tensor, fill: Tensor) -> Tensor:
    """Images moved by whole pixels, as augmentation.

    Args:
        images: (N, channels, height, width).
        offsets: (N, 2) px, down and right, small integers.
        fill: (channels, height, width), what comes in at the border.
    """
    reach = int(offsets.abs().max()) if len(offsets) else 0
    if reach == 0:
        return images
    height, width = images.shape[2:]
    wide = torch.nn.functional.pad(fill.to(images.dtype)[None], (reach,) * 4, mode="replicate")
    wide = wide.repeat(len(images), 1, 1, 1)
    wide[:, :, reach : reach + height, reach : reach + width] = images
    offsets, device = offsets.to(images.device), images.device
    rows = torch.arange(height, device=device)[None, :, None] + reach - offsets[:, 0, None, None]
    columns = torch.arange(width, device=device)[None, None, :] + reach - offsets[:, 1, None, None]
    batch = torch.arange(len(images), device=device)[:, None, None]
    return wide.permute(0, 2, 3, 1)[batch, rows, columns].permute(0, 3, 1, 2)
