"""What the command lines of trainings share: their options, and the run that leaves a network's file and its table."""

from __future__ import annotations

import argparse
import json
import logging
import sys
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from guide3d.commands import in_words
from guide3d.dataset.acquisition_split import Split
from guide3d.dataset.dataset import Dataset, split
from guide3d.files import whole_file
from guide3d.learning.distributed import Ranks
from guide3d.learning.training import FitProgress, FitReport, finished
from guide3d.setting_kinds import seed

PREDICTOR, TABLE = "predictor.pt", "training.json"

_LOGGER = logging.getLogger(__name__)

Progress = Callable[[FitProgress], None]


def training_parser(module: str, description: str | None) -> argparse.ArgumentParser:
    """A parser of the options that all trainings have; `description` is the module's docstring."""
    parser = argparse.ArgumentParser(prog=f"python -m {module}", description=(description or "").split("\n")[0])
    parser.add_argument("data", type=Path, help="folder of the data set")
    parser.add_argument("--output", type=Path, required=True, help="folder of the network")
    parser.add_argument("--pictures", type=Path, help="folder that keeps prepared pictures")
    parser.add_argument("--epochs", type=int, help="instead of the recipe's")
    parser.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto")
    parser.add_argument("--images", type=Path, help="folder of the images, where they lie elsewhere")
    parser.add_argument("--calibration", type=Path, help="folder of the camera files, where they lie elsewhere")
    parser.add_argument("--split-seed", type=seed, default=0, help="of the split by acquisition")
    parser.add_argument("--seed", type=seed, default=0, help="of the training")
    return parser


def data_and_split(given: argparse.Namespace) -> tuple[Dataset, Split]:
    """The data set of a command line, as `training_parser` understood it, and its parts; with its `curves`, if any."""
    curves = getattr(given, "curves", None)
    data = Dataset.open(given.data, images=given.images, calibration=given.calibration, curves=curves)
    return data, split(data, seed=given.split_seed)


def with_epochs(recipe: Any, epochs: int | None) -> Any:
    """A recipe with another number of epochs; None: its own."""
    return recipe if epochs is None else replace(recipe, fit=replace(recipe.fit, epochs=epochs))


def run_training(
    given: argparse.Namespace,
    learn: Callable[..., tuple[Any, FitReport]],
    head: dict[str, Any],
    progress: Progress | None = None,
    save: Callable[[Any, FitReport, dict[str, Any]], None] | None = None,
) -> dict[str, Any]:
    """Trains on this process, or on all those that torchrun started, and writes network and table.

    Args:
        given: options `output`, `pictures`, `seed` and `device`.
        learn: takes the keywords folder, pictures, seed, ranks and progress; returns predictor and report.
        head: the first entries of the table.
        progress: called after every epoch; None: the log gets a line.
        save: writes the predictor's file and may add to the table; None: ``predictor.save(path)``.

    Returns:
        What ``training.json`` holds.
    """
    ranks = Ranks.join(given.device)

    def log(now: FitProgress) -> None:
        if ranks.rank == 0:
            _LOGGER.info("epoch %d of %d: loss %.4f, validation %s", now.epoch, now.epochs, now.loss, now.validation)

    try:
        predictor, report = learn(
            folder=given.output / "fit",
            pictures=given.pictures,
            seed=given.seed,
            ranks=ranks,
            progress=progress or log,
        )
        table = {**head, "processes": ranks.count, **asdict(report)}
        if ranks.rank == 0:
            if save is None:
                predictor.save(given.output / PREDICTOR)
            else:
                save(predictor, report, table)
            with whole_file(given.output / TABLE, "w") as file:
                json.dump(table, file, indent=1)
            finished(given.output / "fit")
        ranks.wait()
        return table
    finally:
        ranks.leave()


def main_of(command: Callable[[list[str]], Any], words: list[str] | None) -> int:
    """Runs a command line; returns its exit code, 2 where it was refused."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    try:
        command(sys.argv[1:] if words is None else words)
    except (ValueError, OSError) as error:
        _LOGGER.error("%s", in_words(error))
        return 2
    return 0
