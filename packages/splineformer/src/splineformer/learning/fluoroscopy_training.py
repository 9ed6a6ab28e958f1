"""Training on random fluoroscopy: from a seed to a predictor, without a data set; resumable by epoch."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import field, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from guide3d.learning.distributed import Ranks
from guide3d.learning.training import FitProgress, FitReport, NetworkFitSettings, fit
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from guide3d.reading.image_reading import shipped_reader
from guide3d.setting_kinds import Count, Share, settings
from splineformer.build import build, size_of
from splineformer.image_input import picture_of
from splineformer.learning.augmentation import Augmentation
from splineformer.learning.drawn_maps import drawn_map
from splineformer.learning.fluoroscopy_samples import ONE, FluoroscopyObjective, draw_pool
from splineformer.learning.recipes import recipe_of
from splineformer.map_picture import WHITE, picture_by_reader
from splineformer.modeling.ordered import OrderedSettings
from splineformer.modeling.published import SplineFormerSettings
from splineformer.predictor import INPUTS, Predictor

VALIDATION_SEED = 1_000_003  # of the images that choices are made by; no training seed should be it
VALIDATION_FIRST = 20_000  # index of the first of them
_FLOOR = 10.0  # grey levels: those of a map mean something by themselves
_MANY = 256  # curves whose mean a network starts from

# what lies in a map has no direction: every turn and mirror image of it is as good
_MAPS_TURNED = Augmentation(
    shift=0.1, turn_deg=180.0, stretch=0.25, gain=0.0, offset=0.0, noise=0.0, hidden=0.0, inverted=0.0, empty=0.0,
    several=0.0,
)  # fmt: skip


@settings
class FluoroscopyRecipe:
    """How a variant is trained on random fluoroscopy.

    Attributes:
        input: "maps", which the shipped reader makes of an image, or "levels", its grey levels.
        images: of the pool, each drawn once.
        validation_images: of another seed, by which the epoch is chosen.
        samples: of an epoch.
        drawn: share of the samples that are maps drawn without an image; only with "maps".
    """

    settings: SplineFormerSettings | OrderedSettings
    fit: NetworkFitSettings
    input: str = "maps"
    images: Count = 1500
    validation_images: Count = 200
    samples: Count = 4000
    drawn: Share = 0.6
    augmentation: Augmentation = _MAPS_TURNED
    fluoroscopy: FluoroscopySettings = field(default_factory=FluoroscopySettings)

    def __post_init__(self) -> None:
        """Refuses an unknown input, and drawn maps beside grey levels."""
        if self.input not in INPUTS:
            raise ValueError(f"unknown input '{self.input}'; there are {', '.join(INPUTS)}")
        if self.input != "maps" and self.drawn:
            raise ValueError(f"maps are drawn only for the input 'maps': expected drawn 0, got {self.drawn}")


def fluoroscopy_recipe(variant: str, size: str, input: str = "maps") -> FluoroscopyRecipe:
    """The recipe of a variant.

    Args:
        variant: "published" or "ordered".
        size: "desk" or "smoke".
        input: see `FluoroscopyRecipe`.

    Raises:
        ValueError: an unknown variant, size or input.
    """
    common = recipe_of(variant, size)
    network = size_of(variant, size)
    maps = input == "maps"
    if maps and isinstance(network, OrderedSettings):
        network = replace(network, floor=_FLOOR)
        if size == "desk":  # wires of any place and direction: more to tell apart
            network = replace(network, encoder_layers=4, decoder_layers=2)
    augmentation = _MAPS_TURNED if maps else replace(_MAPS_TURNED, gain=0.3, offset=10.0, noise=3.0)
    recipe = FluoroscopyRecipe(
        network, replace(common.fit, epochs=30, batch_size=16), input, drawn=0.6 if maps else 0.0,
        augmentation=augmentation,
    )  # fmt: skip
    if size == "smoke":
        few = replace(common.fit, epochs=2, batch_size=8)
        small = FluoroscopySettings(image_px=256)
        return replace(recipe, fit=few, images=6, validation_images=4, samples=16, fluoroscopy=small)
    return recipe


def train_on_fluoroscopy(
    recipe: FluoroscopyRecipe,
    *,
    folder: Path,
    pictures: Path | None = None,
    start: Mapping[str, Tensor] | None = None,
    seed: int = 0,
    ranks: Ranks | None = None,
    progress: Callable[[FitProgress], None] | None = None,
    drawing: Callable[[int, int], None] | None = None,
) -> tuple[Predictor, FitReport]:
    """Trains a variant on random fluoroscopy.

    Args:
        folder: of the checkpoints, which `guide3d.learning.training.finished` removes.
        pictures: folder that keeps the drawn pictures; None: they are drawn again by every start.
        start: weights to begin with, of a network of the same sizes; None: random ones.
        seed: of the images, of weights and samples.
        drawing: called while images are drawn, with their number and that of all.

    Returns:
        The predictor, and what its training was like.

    Raises:
        ValueError: the folders hold something else, or there is nothing to learn from.
    """
    size, side = recipe.settings.image_px, recipe.fluoroscopy.image_px
    make = functools.partial(_picture, input=recipe.input, size_px=size, source_px=side)
    parts = {
        "training": (RandomFluoroscopy(recipe.fluoroscopy, seed), range(recipe.images)),
        "validation": (
            RandomFluoroscopy(recipe.fluoroscopy, VALIDATION_SEED),
            range(VALIDATION_FIRST, VALIDATION_FIRST + recipe.validation_images),
        ),
    }
    source = f"{recipe.input} {size}"
    training, validation = (
        draw_pool(images, indices, make, source, None if pictures is None else pictures / name, drawing)
        for name, (images, indices) in parts.items()
    )
    torch.manual_seed(seed)
    network = build(recipe.settings)
    objective = FluoroscopyObjective(
        training, validation, network, samples=recipe.samples, drawn=recipe.drawn, augmentation=recipe.augmentation,
        background=int(WHITE) if recipe.input == "maps" else 0,
    )  # fmt: skip
    # the training starts from the mean of random curves
    generator = np.random.default_rng((seed, recipe.samples))
    curves = [curve for _ in range(_MANY) if (curve := drawn_map(generator, size).curve) is not None]
    curves += list(training.curves[training.wires == ONE])
    objective.targets.start(objective.targets(curves, None))
    if start is not None:
        try:
            network.load_state_dict(start)
        except RuntimeError as error:
            why = str(error).splitlines()[-1].strip()
            raise ValueError(f"the weights to start from are of another network: {why}") from None
    report = fit(
        network, objective, recipe.fit, folder=folder, seed=seed, recipe=recipe, ranks=ranks, progress=progress
    )
    return Predictor(network, source_px=side, input=recipe.input), report


def _picture(image: NDArray[np.uint8], input: str, size_px: int, source_px: int) -> NDArray[np.uint8]:
    """A network's picture of an image: of the shipped reader's maps, or of the grey levels."""
    if input == "maps":
        return picture_by_reader(image, size_px, shipped_reader()).pixels
    return picture_of(image, size_px, source_px).pixels
