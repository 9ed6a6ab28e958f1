"""Command line of training: a data set to a network's file, on one process or, under torchrun, on many.

::

    python -m guide3d.train DATASET --network spherical --size desk --output FOLDER
    torchrun --nproc-per-node 4 -m guide3d.train DATASET --network transunet --size thesis --output FOLDER

The folder gets ``predictor.pt`` and ``training.json``; the same command goes on after an interruption.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from guide3d.commands import required_by_command, run

if __name__ == "__main__":
    required_by_command("guide3d.train", "torch", "learning")

from guide3d.files import json_fields
from guide3d.learning.build import SEGMENTERS, SIZES
from guide3d.learning.losses import ShapeLoss
from guide3d.learning.network_training import train_network
from guide3d.learning.recipes import FORMS, fgrn_recipe, segmentation_recipe, shape_recipe
from guide3d.learning.training import FitReport
from guide3d.learning.training_command import (
    Progress,
    data_and_split,
    main_of,
    run_training,
    training_parser,
    with_epochs,
)

ANGLES_ALONE = "spherical_angles"  # the spherical form with the loss of the thesis: none on the curve itself
NETWORKS = (*FORMS, ANGLES_ALONE, "fgrn", *SEGMENTERS)


def arguments(words: list[str]) -> argparse.Namespace:
    """Understands the command line."""
    parser = training_parser("guide3d.train", __doc__)
    parser.add_argument("--network", choices=NETWORKS, required=True)
    parser.add_argument("--size", choices=SIZES, default="desk")
    parser.add_argument("--settings", type=json_fields, default={}, help="JSON: fields of the recipe, such as images")
    parser.add_argument("--fit", type=json_fields, default={}, help="JSON: fields of the fit, such as learning_rate")
    parser.add_argument("--pretrained", type=Path, help="weights of a vision transformer, of timm or torchvision")
    parser.add_argument("--curves", type=Path, help="file of fitted curves and curves in space, like sphere.json")
    return parser.parse_args(words)


def train_command(given: argparse.Namespace, progress: Progress | None = None) -> dict[str, Any]:
    """Trains what the command line asks for.

    Args:
        given: as `arguments` understood it.
        progress: called after every epoch; None: the log gets a line.

    Returns:
        What ``training.json`` holds.
    """
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
    if "fit" in given.settings:
        raise ValueError("--settings: the fields of the fit are given by --fit")
    recipe = replace(recipe, fit=replace(recipe.fit, **given.fit), **given.settings)
    recipe = with_epochs(recipe, given.epochs)

    def learn(**common: Any) -> tuple[Any, FitReport]:
        return train_network(*data_and_split(given), recipe, form, pretrained=given.pretrained, **common)

    return run_training(given, learn, {"network": given.network, "size": given.size}, progress)


def main(words: list[str] | None = None) -> int:
    """Runs the command line; returns its exit code."""
    return main_of(lambda words: train_command(arguments(words)), words)


if __name__ == "__main__":
    run(main)
