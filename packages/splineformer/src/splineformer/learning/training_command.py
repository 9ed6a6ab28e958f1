"""Command line of training: a data set to a network's file, on one process or, under torchrun, on many.

::

    python -m splineformer.train DATASET --variant ordered --size desk --output FOLDER
    torchrun --nproc-per-node 4 -m splineformer.train DATASET --variant published --size thesis --output FOLDER

The folder gets ``predictor.pt`` and ``training.json``; the same command goes on after an interruption.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from guide3d.learning.training import FitReport
from guide3d.learning.training_command import (
    PREDICTOR,
    Progress,
    data_and_split,
    main_of,
    run_training,
    training_parser,
    with_epochs,
)
from splineformer.build import SIZES, VARIANTS
from splineformer.learning.recipes import recipe_of
from splineformer.learning.training import train as train_variant
from splineformer.predictor import Predictor

BOARD = "tensorboard"


def arguments(words: list[str]) -> argparse.Namespace:
    """Understands the command line."""
    parser = training_parser("splineformer.train", __doc__)
    parser.add_argument("--variant", choices=VARIANTS, required=True)
    parser.add_argument("--size", choices=sorted({size for sizes in SIZES.values() for size in sizes}), default="desk")
    parser.add_argument("--tensorboard", action="store_true", help="write the losses for TensorBoard, too")
    return parser.parse_args(words)


def train(given: argparse.Namespace, progress: Progress | None = None) -> dict[str, Any]:
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
        return train_variant(*data_and_split(given), recipe, **common)

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
    return main_of(lambda words: train(arguments(words)), words)


if __name__ == "__main__":
    sys.exit(main())
