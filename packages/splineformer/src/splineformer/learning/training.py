"""Training: a data set, its split and a recipe to a predictor; resumable by epoch, on one process or many."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from guide3d.dataset.dataset import VIEWS, images_of, samples_of
from guide3d.learning.distributed import Ranks
from guide3d.learning.picture_store import PictureStore, Preprocessing
from guide3d.learning.training import FitProgress, FitReport, fit
from splineformer.build import build
from splineformer.learning.recipes import Recipe
from splineformer.learning.samples import SplineObjective, curves_of
from splineformer.predictor import Predictor

if TYPE_CHECKING:
    from guide3d.dataset.acquisition_split import Split
    from guide3d.dataset.dataset import Dataset

_MANY = 256  # curves whose mean a network starts from

_LOGGER = logging.getLogger(__name__)


def train(
    data: Dataset,
    split: Split,
    recipe: Recipe,
    *,
    folder: Path,
    pictures: Path | None = None,
    seed: int = 0,
    ranks: Ranks | None = None,
    progress: Callable[[FitProgress], None] | None = None,
) -> tuple[Predictor, FitReport]:
    """Trains a variant on both cameras' images.

    Args:
        folder: of the checkpoints, which `guide3d.learning.training.finished` removes.
        pictures: folder that keeps small pictures; None: in memory.
        seed: of weights, shuffling and variety.

    Returns:
        The predictor, and what its training was like.

    Raises:
        ValueError: images that are not square, or none to learn from.
        TrainingError: checkpoints of something else in the folder.
    """
    preprocessing = Preprocessing(recipe.settings.image_px, data.side_px)
    stores = [PictureStore(data.frames, camera, preprocessing, pictures) for camera in VIEWS]
    torch.manual_seed(seed)
    network = build(recipe.settings)
    objective = SplineObjective(
        stores,
        curves_of(data),
        images_of(data, split.train, recipe.images),
        images_of(data, split.validation, recipe.validation_images),
        network,
        augmentation=recipe.augmentation,
        weights=recipe.weights,
    )
    # the training starts from the mean of the curves that are learnt from
    items = objective.training_items
    probe = items[np.linspace(0, len(items) - 1, min(_MANY, len(items))).astype(int)]
    targets = objective.targets
    targets.start(targets([np.asarray(objective.curves[item]) for item in probe], None))
    report = fit(
        network,
        objective,
        recipe.fit,
        folder=folder,
        seed=seed,
        recipe=(recipe, samples_of(data, split)),
        ranks=ranks,
        progress=progress,
    )
    for store, camera in zip(stores, VIEWS, strict=True):
        if store.damaged:
            _LOGGER.warning("camera %s: %d images could not be read", camera, len(store.damaged))
    return Predictor(network, source_px=data.side_px), report
