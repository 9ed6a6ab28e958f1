"""Command line of the reader's training: from nothing but a seed to a file that `guide3d.reading.maps.Reader` loads.

::

    python -m guide3d.train_reader --output FOLDER
    python -m guide3d.train_reader --output FOLDER --data DATASET --backgrounds FILE.npz --seed 1

The folder gets ``reader.pt`` and ``training.json``; the same command goes on after an interruption.
"""

from __future__ import annotations

import argparse
import json
import logging
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from guide3d.commands import required_by_command, run

if __name__ == "__main__":
    required_by_command("guide3d.train_reader", "torch", "learning")

from guide3d.dataset.dataset import Dataset
from guide3d.files import json_fields, whole_file
from guide3d.learning.reader.evaluation import calibrate, evaluate_reader
from guide3d.learning.reader.training import CHECKPOINT, ReaderRecipe, smoke_recipe, train_reader
from guide3d.learning.training_command import TABLE, main_of
from guide3d.opencv import cv2
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy
from guide3d.reading.maps import SHIPPED, Reader
from guide3d.setting_kinds import seed

VALIDATION_SEED = 1_000_003  # of the images that choices are made by; no training seed should be it
CALIBRATION_SEED = 2_000_003

_LOGGER = logging.getLogger(__name__)


def arguments(words: list[str]) -> argparse.Namespace:
    """Understands the command line."""
    parser = argparse.ArgumentParser(prog="python -m guide3d.train_reader", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--output", type=Path, required=True, help="folder of the reader")
    parser.add_argument("--size", choices=("default", "smoke"), default="default")
    parser.add_argument("--steps", type=int, help="instead of the recipe's")
    parser.add_argument("--settings", type=json_fields, default={}, help="JSON: fields of the recipe")
    parser.add_argument("--fluoroscopy", type=json_fields, default={}, help="JSON: fields of FluoroscopySettings")
    parser.add_argument("--processes", type=int, default=1, help="that draw; 0: none besides this one")
    parser.add_argument("--data", type=Path, action="append", default=[], help="data set whose curves are drawn, too")
    parser.add_argument("--backgrounds", type=Path, help=".npz of attenuations (h, w), drawn behind some images")
    parser.add_argument("--start", type=Path, help="reader whose weights the training begins with")
    parser.add_argument("--images", type=int, default=24, help="random whole images to evaluate with")
    parser.add_argument("--seed", type=seed, default=0, help="of weights and tiles")
    return parser.parse_args(words)


def train(given: argparse.Namespace, progress: Callable[[int, float], None] | None = None) -> dict[str, Any]:
    """Trains what the command line asks for; returns what ``training.json`` holds."""
    cv2.setNumThreads(1)
    recipe = smoke_recipe() if given.size == "smoke" else ReaderRecipe()
    if "fluoroscopy" in given.settings:
        raise ValueError("--settings: the fields of the random images are given by --fluoroscopy")
    if given.images < 1:
        raise ValueError(f"--images: expected at least 1 to evaluate with, got {given.images}")
    recipe = replace(recipe, fluoroscopy=replace(recipe.fluoroscopy, **given.fluoroscopy), **given.settings)
    if given.steps is not None:
        recipe = replace(recipe, steps=given.steps)
    courses = [curve for folder in given.data for curve in curves_of(folder)]
    backgrounds = [] if given.backgrounds is None else backgrounds_of(given.backgrounds)
    start = None if given.start is None else Reader.load(given.start).network.state_dict()
    began = time.monotonic()

    def log(step: int, loss: float) -> None:
        _LOGGER.info("step %d of %d: loss %.4f, %.0f s", step, recipe.steps, loss, time.monotonic() - began)

    network, report = train_reader(
        recipe, given.output, seed=given.seed, processes=given.processes, courses=courses, backgrounds=backgrounds,
        start=start, progress=progress or log,
    )  # fmt: skip
    shift = calibrate(network, RandomFluoroscopy(recipe.fluoroscopy, CALIBRATION_SEED), range(given.images))
    reader = Reader(network, {"training": report, "recipe": asdict(recipe), "calibration": shift})
    validation = RandomFluoroscopy(seed=VALIDATION_SEED)
    scores = asdict(evaluate_reader(reader, validation, range(given.images)))
    table = {**report, "calibration": shift, "validation": scores, "recipe": asdict(recipe)}
    reader.metadata["validation"] = scores
    reader.save(given.output / SHIPPED)
    with whole_file(given.output / TABLE, "w") as file:
        json.dump(table, file, indent=1)
    (given.output / CHECKPOINT).unlink(missing_ok=True)
    _LOGGER.info("%s", json.dumps(scores))
    return table


def curves_of(folder: Path) -> list[NDArray[np.float64]]:
    """The annotated curves of a data set's two views, tip first, scaled to images of 1024 px."""
    data = Dataset.open(folder)
    scale = 1024 / data.side_px
    return [
        scale * np.asarray(points) for frame in data.frames for points in (frame.polyline("a"), frame.polyline("b"))
    ]


def backgrounds_of(path: Path) -> list[NDArray[np.float32]]:
    """The arrays of an ``.npz`` file.

    Raises:
        ValueError: it is no such file.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            return [np.asarray(file[name], np.float32) for name in file.files]
    except Exception as error:  # a damaged archive raises a dozen kinds
        raise ValueError(f"{path} is no .npz of arrays ({error}): save attenuations with numpy.savez") from error


def main(words: list[str] | None = None) -> int:
    """Runs the command line; returns its exit code."""
    return main_of(lambda words: train(arguments(words)), words)


if __name__ == "__main__":
    run(main)
