"""Training: a data set to a network's file, by function or command line, on one process or, under torchrun, on many.

::

    python -m splineformer.train DATASET --variant ordered --size desk --output FOLDER
    torchrun --nproc-per-node 4 -m splineformer.train DATASET --variant published --size thesis --output FOLDER

The folder gets ``predictor.pt`` and ``training.json``; the same command goes on after an interruption.
"""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from guide3d.dataset.dataset import VIEWS, images_of, samples_of
from guide3d.learning.distributed import Ranks
from guide3d.learning.picture_store import PictureStore, Preprocessing
from guide3d.learning.training import FitProgress, FitReport, fit
from guide3d.learning.training_command import (
    PREDICTOR,
    Progress,
    data_and_split,
    main_of,
    run_training,
    training_parser,
    with_epochs,
)
from splineformer.build import SIZES, VARIANTS, build
from splineformer.learning.recipes import Recipe, recipe_of
from splineformer.learning.samples import SplineObjective, curves_of
from splineformer.predictor import Predictor

if TYPE_CHECKING:
    from guide3d.dataset.acquisition_split import Split
    from guide3d.dataset.dataset import Dataset

_MANY = 256  # curves whose mean a network starts from

_LOGGER = logging.getLogger(__name__)

BOARD = "tensorboard"


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


def arguments(words: list[str]) -> argparse.Namespace:
    """Understands the command line."""
    parser = training_parser("splineformer.train", __doc__)
    parser.add_argument("--variant", choices=VARIANTS, required=True)
    parser.add_argument("--size", choices=sorted({size for sizes in SIZES.values() for size in sizes}), default="desk")
    parser.add_argument("--tensorboard", action="store_true", help="write the losses for TensorBoard, too")
    return parser.parse_args(words)


def train_command(given: argparse.Namespace, progress: Progress | None = None) -> dict[str, Any]:
    """Trains what the command line asks for.

    Args:
        given: as `arguments` understood it.
        progress: called after every epoch; None: the log gets a line.

    Returns:
        What ``training.json`` holds.

    Raises:
        ValueError: the data set, the size or a checkpoint cannot be used.
    """
    recipe = with_epochs(recipe_of(given.variant, given.size), given.epochs)

    def learn(**common: Any) -> tuple[Predictor, FitReport]:
        return train(*data_and_split(given), recipe, **common)

    def save(predictor: Predictor, report: FitReport, table: dict[str, Any]) -> None:
        predictor.save(given.output / PREDICTOR, variant=given.variant, best_epoch=report.best_epoch)
        if given.tensorboard:
            write_board(given.output / BOARD, report)

    return run_training(given, learn, {"variant": given.variant, "size": given.size}, progress, save)


def write_board(folder: Path, report: FitReport) -> None:
    """Writes a training's table for TensorBoard.

    Raises:
        ValueError: TensorBoard is not installed.
    """
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError as error:
        raise ValueError("--tensorboard needs the package tensorboard: install it, or leave the option out") from error
    with SummaryWriter(str(folder)) as writer:
        for row in report.rows:
            for name in ("loss", "validation", "learning_rate"):
                if row[name] is not None:
                    writer.add_scalar(f"train/{name}", row[name], row["epoch"])


def main(words: list[str] | None = None) -> int:
    """Runs the command line; returns its exit code."""
    return main_of(lambda words: train_command(arguments(words)), words)


if __name__ == "__main__":
    sys.exit(main())
