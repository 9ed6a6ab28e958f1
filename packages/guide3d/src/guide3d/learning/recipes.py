"""Recipes: size, preprocessing, loss and training of each network, as the thesis has them, for a desk, and for a test.

What the thesis leaves open is said here: the weights of the shape network's loss (all 1), the losses and optimisers of
the segmentation networks (those of TransUNet: cross-entropy and Dice in equal parts, descent with momentum, falling to
nothing; the UNet's low rate suits NAdam), and the sizes of its batches.
"""

from __future__ import annotations

from dataclasses import field
from typing import Any

from guide3d.learning.build import FGRN_SIZES, SEGMENTER_SIZES, SEGMENTERS, SHAPE_SIZES, SIZES, ShapeSize
from guide3d.learning.losses import ShapeLoss
from guide3d.learning.picture_store import Preprocessing
from guide3d.learning.segmentation_samples import SegmentationAugmentation
from guide3d.learning.shape_samples import ShapeAugmentation
from guide3d.learning.training import NetworkFitSettings
from guide3d.setting_kinds import Count, CountOrNone, Millimetres, PixelDistance, Pixels, Share, settings

FORMS = ("spherical", "cartesian")
PUBLIC_PX = 1024


@settings
class ShapeRecipe:
    """How the shape network is trained.

    Attributes:
        step_mm: radius of the spherical form, spacing of the positions.
        cumulative: angles are offsets from step to step; else from one reference direction.
        targets: windows a clip: their frames are seen once.
    """

    size: ShapeSize
    preprocessing: Preprocessing
    fit: NetworkFitSettings
    loss: ShapeLoss = field(default_factory=ShapeLoss)
    step_mm: Millimetres = 1.7
    cumulative: bool = True
    targets: Count = 1
    augmentation: ShapeAugmentation = field(default_factory=lambda: ShapeAugmentation(0.0, 0.0))


@settings
class FGRNRecipe:
    """How 3D-FGRN is trained: points every 2 mm, up to the longest curve."""

    sizes: dict[str, Any]
    preprocessing: Preprocessing
    fit: NetworkFitSettings
    spacing_mm: Millimetres = 2.0
    augmentation: ShapeAugmentation = field(default_factory=lambda: ShapeAugmentation(0.0, 0.0))


@settings
class SegmentationRecipe:
    """How a segmentation network is trained.

    Attributes:
        crop_px: side of what the network sees at once, px of the picture.
        mask_px: width of the wire, px of the camera's image.
        images: to learn from, at most; 0: all.
        validation_images: to validate with, at most; 0: all.
    """

    network: str
    sizes: dict[str, Any]
    preprocessing: Preprocessing
    fit: NetworkFitSettings
    crop_px: Pixels
    mask_px: PixelDistance = 6.0
    dice: Share = 0.5
    images: CountOrNone = 0
    validation_images: CountOrNone = 0
    augmentation: SegmentationAugmentation = field(default_factory=SegmentationAugmentation)


def shape_recipe(size: str) -> ShapeRecipe:
    """The shape network's recipe of size "thesis", "desk" or "smoke"; ValueError for another."""
    _check(size)
    network = SHAPE_SIZES[size]
    if size == "thesis":
        return ShapeRecipe(network, Preprocessing(network.image_px, PUBLIC_PX), NetworkFitSettings())
    lines = Preprocessing(network.image_px, PUBLIC_PX, line_px=13, gain=8.0, first_px=2 if size == "desk" else 1)
    fit = NetworkFitSettings(
        epochs=20 if size == "desk" else 1, batch_size=32, optimiser="adamw", learning_rate=2e-3, weight_decay=0.02,
        schedule="one_cycle", patience=0, clip=10.0,
    )  # fmt: skip
    return ShapeRecipe(
        network, lines, fit, ShapeLoss(tip=0.3, offset=0.0, stop=0.02, curve=1.0, length=0.05, robust=True),
        cumulative=False, augmentation=ShapeAugmentation(gain=0.2, noise=4.0),
    )  # fmt: skip


def fgrn_recipe(size: str) -> FGRNRecipe:
    """3D-FGRN's recipe of size "thesis", "desk" or "smoke"; ValueError for another."""
    _check(size)
    sizes = FGRN_SIZES[size]
    if size == "thesis":
        return FGRNRecipe(sizes, Preprocessing(80, PUBLIC_PX), NetworkFitSettings(epochs=30, batch_size=16))
    lines = Preprocessing(80, PUBLIC_PX, line_px=13, gain=8.0)
    fit = NetworkFitSettings(
        epochs=20 if size == "desk" else 1, batch_size=16, learning_rate=1e-3, schedule="one_cycle", patience=0
    )
    return FGRNRecipe(sizes, lines, fit, augmentation=ShapeAugmentation())


def segmentation_recipe(network: str, size: str) -> SegmentationRecipe:
    """The recipe of "unet", "transunet" or "swinunet" in size "thesis", "desk" or "smoke"; ValueError for another."""
    _check(size)
    if network not in SEGMENTERS:
        raise ValueError(f"unknown segmentation network '{network}'; there are {', '.join(SEGMENTERS)}")
    sizes = SEGMENTER_SIZES[network][size]
    if size == "thesis":
        rates: dict[str, dict[str, Any]] = {
            "unet": {"epochs": 135, "learning_rate": 1e-5},
            "transunet": {"epochs": 199, "learning_rate": 0.01, "optimiser": "sgd", "schedule": "polynomial"},
            "swinunet": {"epochs": 299, "learning_rate": 0.01, "optimiser": "sgd", "schedule": "polynomial"},
        }
        decay = 1e-4 if network != "unet" else 0.0
        fit = NetworkFitSettings(
            **{"batch_size": 24 if network != "unet" else 4, "weight_decay": decay, **rates[network]}
        )
        side = 224 if network != "unet" else 512
        # whole images, as the thesis feeds them
        return SegmentationRecipe(network, sizes, Preprocessing(side, PUBLIC_PX), fit, crop_px=side)
    desk = size == "desk"
    side, crop = (512, 128) if desk else (128, 64)
    fit = NetworkFitSettings(
        epochs=8 if desk else 1, batch_size=8, optimiser="adamw", learning_rate=3e-3, weight_decay=0.01,
        schedule="one_cycle", patience=0, clip=5.0,
    )  # fmt: skip
    return SegmentationRecipe(
        network, sizes, Preprocessing(side, PUBLIC_PX, flat_px=25, gain=4.0), fit, crop_px=crop,
        images=600 if desk else 16, validation_images=48 if desk else 4,
    )  # fmt: skip


def _check(size: str) -> None:
    if size not in SIZES:
        raise ValueError(f"unknown size '{size}'; there are {', '.join(SIZES)}")
