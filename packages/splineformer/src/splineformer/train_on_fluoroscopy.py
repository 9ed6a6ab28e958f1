"""Command line of the training on random fluoroscopy: from nothing but a seed to a network's file.

::

    python -m splineformer.train_on_fluoroscopy --variant ordered --output FOLDER
    python -m splineformer.train_on_fluoroscopy --variant ordered --output FOLDER --pictures FOLDER --seed 1
    torchrun --nproc-per-node 4 -m splineformer.train_on_fluoroscopy --output FOLDER --pictures FOLDER

The folder gets ``predictor.pt`` and ``training.json``; the same command goes on after an interruption.
"""

from __future__ import annotations

import argparse
import json
import logging
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from guide3d.commands import required_by_command, run

if __name__ == "__main__":
    required_by_command("splineformer.train_on_fluoroscopy", "torch", "learning")

import torch

from guide3d.files import json_fields
from guide3d.learning.distributed import Ranks
from guide3d.learning.training import FitReport
from guide3d.learning.training_command import PREDICTOR, Progress, main_of, run_training, with_epochs
from guide3d.opencv import cv2
from guide3d.setting_kinds import seed
from splineformer.build import VARIANTS
from splineformer.comparison.fluoroscopy_figures import evaluate_on_fluoroscopy
from splineformer.learning.fluoroscopy_training import FluoroscopyRecipe, fluoroscopy_recipe, train_on_fluoroscopy
from splineformer.predictor import INPUTS, Predictor

_LOGGER = logging.getLogger(__name__)


def arguments(words: list[str]) -> argparse.Namespace:
    """Understands the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m splineformer.train_on_fluoroscopy", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("--output", type=Path, required=True, help="folder of the network")
    parser.add_argument("--variant", choices=VARIANTS, default="ordered")
    parser.add_argument("--size", choices=("desk", "smoke"), default="desk")
    parser.add_argument("--input", choices=INPUTS, default="maps", help="maps of the shipped reader, or grey levels")
    parser.add_argument("--pictures", type=Path, help="folder that keeps the drawn pictures")
    parser.add_argument("--epochs", type=int, help="instead of the recipe's")
    parser.add_argument("--settings", type=json_fields, default={}, help="JSON: fields of the recipe, such as images")
    parser.add_argument("--fit", type=json_fields, default={}, help="JSON: fields of the fit, such as learning_rate")
    parser.add_argument("--network", type=json_fields, default={}, help="JSON: sizes of the network")
    parser.add_argument("--fluoroscopy", type=json_fields, default={}, help="JSON: fields of FluoroscopySettings")
    parser.add_argument("--weights", type=Path, help="network with whose weights the training begins")
    parser.add_argument("--test-images", type=int, default=40, help="random whole images to evaluate with")
    parser.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto")
    parser.add_argument("--seed", type=seed, default=0, help="of images, weights and samples")
    return parser.parse_args(words)


def train(given: argparse.Namespace, progress: Progress | None = None) -> dict[str, Any]:
    """Trains what the command line asks for; returns what ``training.json`` holds.

    Args:
        progress: called after every epoch; None: the log gets a line.

    Raises:
        ValueError: a setting or a folder cannot be used.
    """
    cv2.setNumThreads(1)
    recipe = _recipe(given)
    start = None if given.weights is None else Predictor.load(given.weights).network.state_dict()

    def learn(*, ranks: Ranks, **common: Any) -> tuple[Predictor, FitReport]:
        def drawing(count: int, of: int) -> None:
            if ranks.rank == 0 and (count == of or count % 250 == 0):
                _LOGGER.info("%d of %d images", count, of)

        return train_on_fluoroscopy(recipe, start=start, ranks=ranks, drawing=drawing, **common)

    def save(predictor: Predictor, report: FitReport, table: dict[str, Any]) -> None:
        table["test"] = evaluate_on_fluoroscopy(predictor, recipe.fluoroscopy, given.test_images)
        predictor.save(given.output / PREDICTOR, variant=given.variant, best_epoch=report.best_epoch)
        _LOGGER.info("%s", json.dumps(table["test"]))

    head = {"variant": given.variant, "size": given.size, "recipe": asdict(recipe)}
    return run_training(given, learn, head, progress, save)


def _recipe(options: argparse.Namespace) -> FluoroscopyRecipe:
    recipe = with_epochs(fluoroscopy_recipe(options.variant, options.size, options.input), options.epochs)
    network = {name: tuple(value) if isinstance(value, list) else value for name, value in options.network.items()}
    try:
        return replace(
            recipe, settings=replace(recipe.settings, **network), fit=replace(recipe.fit, **options.fit),
            fluoroscopy=replace(recipe.fluoroscopy, **options.fluoroscopy), **options.settings,
        )  # fmt: skip
    except TypeError as error:
        raise ValueError(f"an option names a setting that there is not: {error}") from error


def main(words: list[str] | None = None) -> int:
    """Runs the command line; returns its exit code."""
    torch.set_num_threads(1)
    return main_of(lambda words: train(arguments(words)), words)


if __name__ == "__main__":
    run(main)
