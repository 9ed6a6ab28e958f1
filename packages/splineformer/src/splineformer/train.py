"""Command line of training: a data set to a network's file, on one process or, under torchrun, on many.

::

    python -m splineformer.train DATASET --variant ordered --size desk --output FOLDER
    torchrun --nproc-per-node 4 -m splineformer.train DATASET --variant published --size thesis --output FOLDER

The folder gets ``predictor.pt`` and ``training.json``; the same command goes on after an interruption.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from guide3d.atomic_file import whole_file
from guide3d.dataset.dataset import Dataset, split
from guide3d.learning.distributed import Ranks
from guide3d.learning.training import FitProgress, FitReport, finished
from guide3d.setting_kinds import seed
from splineformer.build import SIZES, VARIANTS
from splineformer.learning.recipes import recipe_of
from splineformer.learning.training import train as train_variant

PREDICTOR, TABLE, BOARD = "predictor.pt", "training.json", "tensorboard"

_LOGGER = logging.getLogger("splineformer.train")


def arguments(words: list[str]) -> argparse.Namespace:
    """Understands the command line."""
    parser = argparse.ArgumentParser(prog="python -m splineformer.train", description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="folder of the data set")
    parser.add_argument("--variant", choices=VARIANTS, required=True)
    parser.add_argument("--size", choices=sorted({size for sizes in SIZES.values() for size in sizes}), default="desk")
    parser.add_argument("--output", type=Path, required=True, help="folder of the network")
    parser.add_argument("--pictures", type=Path, help="folder that keeps small pictures")
    parser.add_argument("--epochs", type=int, help="instead of the recipe's")
    parser.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto")
    parser.add_argument("--images", type=Path, help="folder of the images, where they lie elsewhere")
    parser.add_argument("--calibration", type=Path, help="folder of the camera files, where they lie elsewhere")
    parser.add_argument("--split-seed", type=seed, default=0, help="of the split by acquisition")
    parser.add_argument("--seed", type=seed, default=0, help="of the training")
    parser.add_argument("--tensorboard", action="store_true", help="write the losses for TensorBoard, too")
    return parser.parse_args(words)


def train(given: argparse.Namespace, progress: Callable[[FitProgress], None] | None = None) -> dict[str, Any]:
    """Trains what the command line asks for.

    Args:
        given: as `arguments` understood it.
        progress: called after every epoch; None: the log is told.

    Returns:
        What ``training.json`` holds.

    Raises:
        ValueError: the data set, the size or a checkpoint cannot be used.
    """
    recipe = recipe_of(given.variant, given.size)
    if given.epochs is not None:
        recipe = replace(recipe, fit=replace(recipe.fit, epochs=given.epochs))
    ranks = Ranks.join(given.device)
    try:
        data = Dataset.open(given.data, images=given.images, calibration=given.calibration)

        def tell(now: FitProgress) -> None:
            if ranks.rank == 0:
                _LOGGER.info(
                    "epoch %d of %d: loss %.4f, validation %s", now.epoch, now.epochs, now.loss, now.validation
                )

        predictor, report = train_variant(
            data,
            split(data, seed=given.split_seed),
            recipe,
            folder=given.output / "fit",
            pictures=given.pictures,
            seed=given.seed,
            ranks=ranks,
            progress=progress or tell,
        )
        told = {"variant": given.variant, "size": given.size, "processes": ranks.count, **asdict(report)}
        if ranks.rank == 0:
            predictor.save(given.output / PREDICTOR, variant=given.variant, best_epoch=report.best_epoch)
            with whole_file(given.output / TABLE, "w") as file:
                json.dump(told, file, indent=1)
            if given.tensorboard:
                write_board(given.output / BOARD, report)
            finished(given.output / "fit")
        ranks.wait()
        return told
    finally:
        ranks.leave()


def write_board(folder: Path, report: FitReport) -> None:
    """Writes a training's table for TensorBoard.

    Args:
        folder: of the event file.
        report: of the training.

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
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    given = arguments(sys.argv[1:] if words is None else words)
    try:
        train(given)
    except (ValueError, OSError) as error:
        _LOGGER.error("%s", error)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
