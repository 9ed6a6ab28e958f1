"""Command line of training: a data set to a network's file, on one process or, under torchrun, on many.

::

    python -m guide3d.train DATASET --network spherical --size desk --output FOLDER
    torchrun --nproc-per-node 4 -m guide3d.train DATASET --network transunet --size thesis --output FOLDER

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
from guide3d.learning.build import SEGMENTERS, SIZES
from guide3d.learning.distributed import Ranks
from guide3d.learning.losses import ShapeLoss
from guide3d.learning.network_training import train_network
from guide3d.learning.recipes import FORMS, fgrn_recipe, segmentation_recipe, shape_recipe
from guide3d.learning.training import FitProgress, finished
from guide3d.setting_kinds import seed

ANGLES_ALONE = "spherical_angles"  # the spherical form with the loss of the thesis: none on the curve itself
NETWORKS = (*FORMS, ANGLES_ALONE, "fgrn", *SEGMENTERS)
PREDICTOR, TABLE = "predictor.pt", "training.json"

_LOGGER = logging.getLogger("guide3d.train")


def arguments(words: list[str]) -> argparse.Namespace:
    """Understands the command line."""
    parser = argparse.ArgumentParser(prog="python -m guide3d.train", description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, help="folder of the data set")
    parser.add_argument("--network", choices=NETWORKS, required=True)
    parser.add_argument("--size", choices=SIZES, default="desk")
    parser.add_argument("--output", type=Path, required=True, help="folder of the network")
    parser.add_argument("--pictures", type=Path, help="folder that keeps prepared pictures")
    parser.add_argument("--pretrained", type=Path, help="weights of a vision transformer, of timm or torchvision")
    parser.add_argument("--epochs", type=int, help="instead of the recipe's")
    parser.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto")
    parser.add_argument("--images", type=Path, help="folder of the images, where they lie elsewhere")
    parser.add_argument("--calibration", type=Path, help="folder of the camera files, where they lie elsewhere")
    parser.add_argument("--curves", type=Path, help="file of fitted curves and curves in space, like sphere.json")
    parser.add_argument("--split-seed", type=seed, default=0, help="of the split by acquisition")
    parser.add_argument("--seed", type=seed, default=0, help="of the training")
    return parser.parse_args(words)


def train(given: argparse.Namespace, progress: Callable[[FitProgress], None] | None = None) -> dict[str, Any]:
    """Trains what the command line asks for.

    Args:
        given: as `arguments` understood it.
        progress: called after every epoch; None: it is logged.

    Returns:
        What ``training.json`` holds.
    """
    ranks = Ranks.join(given.device)
    try:
        data = Dataset.open(given.data, images=given.images, calibration=given.calibration, curves=given.curves)
        parts = split(data, seed=given.split_seed)
        fold = given.output / "fit"

        def tell(now: FitProgress) -> None:
            if ranks.rank == 0:
                _LOGGER.info(
                    "epoch %d of %d: loss %.4f, validation %s", now.epoch, now.epochs, now.loss, now.validation
                )

        form = "spherical" if given.network == ANGLES_ALONE else given.network
        if given.pretrained is not None and form not in FORMS:
            raise ValueError("--pretrained fills the vision transformer of the shape network only")
        recipe: Any
        if form in FORMS:
            recipe = shape_recipe(given.size)
            if given.network == ANGLES_ALONE:
                recipe = replace(recipe, loss=ShapeLoss())
        else:
            recipe = fgrn_recipe(given.size) if form == "fgrn" else segmentation_recipe(form, given.size)
        if given.epochs is not None:
            recipe = replace(recipe, fit=replace(recipe.fit, epochs=given.epochs))
        predictor, report = train_network(
            data, parts, recipe, form, folder=fold, pictures=given.pictures, pretrained=given.pretrained,
            seed=given.seed, ranks=ranks, progress=progress or tell,
        )  # fmt: skip
        table = {"network": given.network, "size": given.size, "processes": ranks.count, **asdict(report)}
        if ranks.rank == 0:
            predictor.save(given.output / PREDICTOR)
            with whole_file(given.output / TABLE, "w") as file:
                json.dump(table, file, indent=1)
            finished(fold)
        ranks.wait()
        return table
    finally:
        ranks.leave()


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
