"""Recipes: size, loss, augmentation and training of each variant, by size."""

from __future__ import annotations

from dataclasses import field, replace

from guide3d.learning.training import NetworkFitSettings
from guide3d.setting_kinds import CountOrNone, settings
from splineformer.build import size_of
from splineformer.learning.augmentation import Augmentation
from splineformer.modeling.ordered import OrderedSettings
from splineformer.modeling.published import SplineFormerSettings

_PLAIN = Augmentation(
    shift=0.0, turn_deg=0.0, stretch=0.0, gain=0.0, offset=0.0, noise=0.0, hidden=0.0, inverted=0.0, empty=0.0,
    several=0.0,
)  # fmt: skip
# of the size desk a network sees few images: it learns the cameras as they stand, and every image counts
_NEARLY_STILL = Augmentation(
    shift=0.01, turn_deg=2.0, stretch=0.02, inverted=0.05, empty=0.04, several=0.04, turn_a_pass=3.0,
)  # fmt: skip


@settings
class Recipe:
    """How a variant is trained.

    Attributes:
        images: to learn from, at most; 0: all.
        validation_images: at most; 0: all.
    """

    settings: SplineFormerSettings | OrderedSettings
    fit: NetworkFitSettings
    augmentation: Augmentation = field(default_factory=Augmentation)
    images: CountOrNone = 0
    validation_images: CountOrNone = 0


def recipe_of(variant: str, size: str) -> Recipe:
    """The recipe of a variant.

    Args:
        variant: "published" or "ordered".
        size: "thesis", "thesis_large" (published only), "desk" or "smoke".

    Returns:
        At the thesis's sizes the published variant is trained as there, without augmentation: Adam, 1e-5, 300 epochs.

    Raises:
        ValueError: an unknown variant or size.
    """
    settings = size_of(variant, size)
    published = variant == "published"
    if size.startswith("thesis"):
        # Adam without decay is AdamW with a decay of nothing
        fit = NetworkFitSettings(
            epochs=300, batch_size=16, optimiser="adamw", learning_rate=1e-5 if published else 5e-4,
            schedule="constant" if published else "one_cycle", patience=0, clip=0.0 if published else 5.0,
            weight_decay=0.0 if published else 0.02,
        )  # fmt: skip
        kinds = replace(_PLAIN, inverted=0.08, empty=0.05, several=0.05)
        return Recipe(settings, fit, kinds if published else Augmentation())
    desk = size == "desk"
    epochs = {"published": 4, "ordered": 18}[variant] if desk else 1
    fit = NetworkFitSettings(
        epochs=epochs, batch_size=(16 if published else 12) if desk else 8, optimiser="adamw",
        learning_rate=1e-3 if published else 1.5e-3,
        weight_decay=0.02, schedule="one_cycle", patience=0, clip=1.0 if published else 5.0,
    )  # fmt: skip
    return Recipe(settings, fit, _NEARLY_STILL, images=0 if desk else 16, validation_images=96 if desk else 4)
