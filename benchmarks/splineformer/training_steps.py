"""Processor time of trainings in bfloat16 beside float32: ordered SplineFormer, shape and segmentation networks.

    python benchmarks/splineformer/training_steps.py runs/desk/guide3d
    python benchmarks/splineformer/training_steps.py runs/desk/guide3d --networks ordered --acquisitions 4 --repeats 3

Each network is trained for one epoch of its recipe for a desk on a few acquisitions of a run's data set (of each part),
in turns with products of matrices in float32 and in bfloat16, preparation of the images and validation included, in one
thread. The first epochs prepare the small pictures and are not counted. Prints one JSON line a network: the median CPU
time of an epoch in both, s, the median of the ratios of neighbours, and the least and the largest of them.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any
from unittest.mock import patch

import torch

from guide3d.dataset.acquisition_split import Split
from guide3d.dataset.dataset import Dataset, split
from guide3d.learning.network_training import train_network
from guide3d.learning.precision import has_bfloat16
from guide3d.learning.recipes import FORMS, fgrn_recipe, segmentation_recipe, shape_recipe
from pipeline.stages.guide3d.folder import open_dataset
from splineformer.learning.recipes import recipe_of
from splineformer.learning.training import train

ORDERED = "ordered"  # SplineFormer as published trains in float32
NETWORKS = (ORDERED, *FORMS, "fgrn", "unet", "transunet", "swinunet")
PRECISION = "guide3d.learning.precision.has_bfloat16"


def epoch_of(network: str, data: Dataset, parts: Split, pictures: Path) -> Callable[[], float]:
    """What trains a network for one epoch and returns the CPU time, s."""
    recipe: Any
    if network == ORDERED:
        recipe = recipe_of(network, "desk")
    elif network in FORMS:
        recipe = shape_recipe("desk")
    else:
        recipe = fgrn_recipe("desk") if network == "fgrn" else segmentation_recipe(network, "desk")
    recipe = replace(recipe, fit=replace(recipe.fit, epochs=1))

    def epoch() -> float:
        with tempfile.TemporaryDirectory() as folder:
            given: dict[str, Any] = {"folder": Path(folder), "pictures": pictures, "seed": 0}
            if network == ORDERED:
                report = train(data, parts, recipe, **given)[1]
            else:
                form = network if network in FORMS else FORMS[0]
                report = train_network(data, parts, recipe, form, **given)[1]
            return report.cpu_s

    return epoch


def main() -> None:
    """Prints a JSON line a network."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("run", type=Path, help="folder of the stage guide3d of a run")
    parser.add_argument("--networks", nargs="+", choices=NETWORKS, default=NETWORKS, metavar="NAME")
    parser.add_argument("--acquisitions", type=int, default=2, metavar="COUNT", help="of each part")
    parser.add_argument("--repeats", type=int, default=3, metavar="COUNT", help="epochs of each precision")
    given = parser.parse_args()
    if not has_bfloat16():
        sys.exit("this processor does not multiply bfloat16 by itself: there is nothing to compare")
    torch.set_num_threads(1)
    data = open_dataset(given.run)
    whole = split(data)
    parts = replace(
        whole, **{name: getattr(whole, name)[: given.acquisitions] for name in ("train", "validation", "test")}
    )
    with tempfile.TemporaryDirectory() as pictures:
        for network in given.networks:
            epoch = epoch_of(network, data, parts, Path(pictures))
            epoch()
            spent: dict[bool, list[float]] = {False: [], True: []}
            for _ in range(given.repeats):
                for reduced, times in spent.items():
                    with patch(PRECISION, return_value=reduced):
                        times.append(epoch())
            ratios = sorted(there / here for here, there in zip(spent[False], spent[True], strict=True))
            found = {
                "network": network,
                "float32_s": round(median(spent[False]), 2),
                "bfloat16_s": round(median(spent[True]), 2),
                "ratio": round(median(ratios), 3),
                "ratios": [round(ratios[0], 3), round(ratios[-1], 3)],
            }
            print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main()
