"""Lumen segmentation: which pixels of a fluoroscopic image show the vessel, by a small U-shaped network."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from enn.imitation.images.wire_segmentation import fitted
from enn.networks.devices import device_of

WORKING_SIZE = 96  # px: images are brought to this side
_SHIFT = 6  # px, of the augmentation


class LumenSegmenter(nn.Module):
    """Probability of the lumen for every pixel; the image's mean and contrast do not matter.

    Args:
        width: channels at full resolution, doubled at each of the two coarser ones; a multiple of 4.
        working_size: px, the side that images are brought to; a multiple of 4.
    """

    def __init__(self, width: int = 8, working_size: int = WORKING_SIZE) -> None:
        super().__init__()
        self.width, self.working_size = width, working_size
        self.fine, self.middle, self.coarse = _block(1, width), _block(width, 2 * width), _block(2 * width, 4 * width)
        self.deep = nn.Sequential(
            nn.Conv2d(4 * width, 4 * width, 3, padding=3, dilation=3), nn.ReLU(), _block(4 * width, 4 * width)
        )
        self.up_middle, self.up_fine = _block(6 * width, 2 * width), _block(3 * width, width)
        self.head = nn.Conv2d(width, 1, 1)

    def forward(self, images: Tensor) -> Tensor:
        """Logits of images of any brightness. Shape (N, 1, size, size) to the same, size a multiple of 4."""
        mean, spread = images.mean((1, 2, 3), keepdim=True), images.std((1, 2, 3), keepdim=True)
        fine = self.fine((images - mean) / (spread + 1e-6))
        middle = self.middle(functional.max_pool2d(fine, 2))
        coarse = self.deep(self.coarse(functional.max_pool2d(middle, 2)))
        middle = self.up_middle(torch.cat((functional.interpolate(coarse, scale_factor=2.0), middle), 1))
        fine = self.up_fine(torch.cat((functional.interpolate(middle, scale_factor=2.0), fine), 1))
        return self.head(fine)

    @torch.inference_mode()
    def lumen(self, image: NDArray[np.floating]) -> NDArray[np.float32]:
        """Probability of the lumen in an image without a wire.

        Args:
            image: grey levels. Shape (size, size).

        Returns:
            Shape (size, size).
        """
        self.eval()
        pixels = torch.as_tensor(np.array(image, np.float32))[None, None].to(device_of(self))
        small = torch.sigmoid(self(_resized(pixels, self.working_size)))
        return _resized(small, image.shape[-1])[0, 0].cpu().numpy()


def fit_segmenter(
    images: NDArray[np.floating],
    lumens: NDArray[np.floating],
    *,
    epochs: int = 30,
    working_size: int = WORKING_SIZE,
    seed: int = 0,
    progress: Callable[[int, float], None] | None = None,
    device: torch.device | str = "cpu",
) -> tuple[LumenSegmenter, float]:
    """Trains a segmenter; images are shifted, stretched and their contrast changed at random.

    Args:
        images: grey levels without a wire. Shape (n, size, size).
        lumens: 1 where the lumen is seen. Shape (n, size, size).
        working_size: px, of the segmenter.
        progress: called with each epoch's number and loss.

    Returns:
        The segmenter, and the overlap (intersection over union) on the training images.

    Raises:
        ValueError: no images, or of other shapes than the lumens.
    """
    if images.ndim != 3 or images.shape != lumens.shape or not len(images):
        raise ValueError(f"expected images and lumens of one shape (n, size, size), got {images.shape}, {lumens.shape}")
    x = _resized(torch.as_tensor(np.asarray(images, np.float32))[:, None], working_size)
    y = _resized(torch.as_tensor(np.asarray(lumens, np.float32))[:, None], working_size)

    def loss_of(network: LumenSegmenter, rows: NDArray[np.intp], generator: np.random.Generator) -> Tensor:
        chosen = torch.as_tensor(rows)
        pair = _augmented(torch.cat((x[chosen], y[chosen]), 1).to(device), generator)
        return functional.binary_cross_entropy_with_logits(network(pair[:, :1]).float(), pair[:, 1:])

    network = fitted(
        lambda: LumenSegmenter(working_size=working_size), len(x), loss_of,
        epochs=epochs, seed=seed, progress=progress, device=device,
    )  # fmt: skip
    return network, overlap(network, images, lumens)


def overlap(network: LumenSegmenter, images: NDArray[np.floating], lumens: NDArray[np.floating]) -> float:
    """Intersection over union of the segmented lumens and the true ones, all images together."""
    masks = np.stack([network.lumen(image) for image in images]) > 0.5
    true = lumens > 0.5
    return float((masks & true).sum() / max((masks | true).sum(), 1))


def _augmented(pair: Tensor, generator: np.random.Generator) -> Tensor:
    count = len(pair)
    stretch = generator.uniform(0.85, 1.15, (count, 2))
    angle = generator.uniform(-0.1, 0.1, count)
    shift = generator.uniform(-2 * _SHIFT, 2 * _SHIFT, (count, 2)) / pair.shape[-1]
    affine = np.zeros((count, 2, 3), np.float32)
    affine[:, 0, 0], affine[:, 0, 1] = stretch[:, 0] * np.cos(angle), -np.sin(angle)
    affine[:, 1, 0], affine[:, 1, 1] = np.sin(angle), stretch[:, 1] * np.cos(angle)
    affine[:, :, 2] = shift
    grid = functional.affine_grid(torch.as_tensor(affine).to(pair.device), list(pair.shape), align_corners=False)
    moved = functional.grid_sample(pair, grid, padding_mode="border", align_corners=False)
    noise = torch.as_tensor(generator.normal(0.0, 1.5, (count, 1, *pair.shape[2:])).astype(np.float32))
    return torch.cat((moved[:, :1] + noise.to(pair.device), moved[:, 1:]), 1)


def _block(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, padding=1),
        nn.GroupNorm(4, outputs),
        nn.ReLU(),
        nn.Conv2d(outputs, outputs, 3, padding=1),
        nn.ReLU(),
    )


def _resized(images: Tensor, size: int) -> Tensor:
    if images.shape[-1] == size:
        return images
    return functional.interpolate(images, (size, size), mode="bilinear", align_corners=False, antialias=True)
