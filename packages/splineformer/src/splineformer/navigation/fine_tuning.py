"""Fine-tunes SplineFormer on wires under the navigation's cameras.

The data set shows wires deep in one phantom. A navigation begins with a short wire, in other anatomies, and folds its
tip at walls and in wrong branches.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from guide3d.learning.distributed import Ranks
from guide3d.learning.training import FitProgress, fit
from splineformer.comparison.evaluation import curve_errors
from splineformer.learning.recipes import recipe_of
from splineformer.learning.samples import SplineObjective
from splineformer.navigation.perception import PerceptionNetwork
from splineformer.predictor import Predictor

CURVE_POINTS = 240  # of a true curve
_LEARNING_RATE = 6e-4


@dataclass(frozen=True, eq=False)
class WirePictures:
    """Pictures of wires.

    Attributes:
        pictures: (N, size, size) in the network's size.
        curves: (N, CURVE_POINTS, 2) x and y of the true curves, tip first, shares of the picture's sides.
        held_out: (N,) whether a picture is kept for validation.
    """

    pictures: NDArray[Any]
    curves: NDArray[np.float64]
    held_out: NDArray[np.bool_]


class _Stored:
    """Pictures as an array, as training takes them."""

    def __init__(self, pictures: NDArray[Any]) -> None:
        self._pictures = pictures

    def healthy(self, indices: NDArray[Any]) -> NDArray[np.bool_]:
        return np.ones(len(indices), bool)

    def pictures(self, indices: NDArray[Any]) -> NDArray[Any]:
        return self._pictures[indices]


def fine_tune(
    predictor: Predictor,
    data: WirePictures,
    variant: str,
    epochs: int,
    *,
    folder: Path,
    seed: int,
    device: str = "cpu",
    progress: Callable[[FitProgress], None] = lambda now: None,
) -> tuple[Predictor, dict[str, Any]]:
    """Trains a SplineFormer further.

    Args:
        predictor: whose network is trained in place.
        data: pictures to train with and to validate with.
        variant: whose recipe for a desk is followed.
        folder: for the checkpoint of the fit.

    Returns:
        The predictor, and the number of images, the CPU time in minutes, and the errors before and after.
    """
    places = np.arange(len(data.curves))
    recipe = recipe_of(variant, "desk")
    objective = SplineObjective(
        [_Stored(data.pictures)], list(data.curves), places[~data.held_out], places[data.held_out], predictor.network,
        augmentation=recipe.augmentation,
    )  # fmt: skip
    outcome: dict[str, Any] = {f"{name}_before": value for name, value in errors(predictor, data).items()}
    settings = replace(recipe.fit, epochs=epochs, learning_rate=_LEARNING_RATE)
    fitted = fit(
        predictor.network,
        objective,
        settings,
        folder=folder,
        seed=seed,
        recipe=(recipe, hashlib.sha256(data.curves.tobytes()).hexdigest()),
        ranks=Ranks.join(device),
        progress=progress,
    )
    predictor = Predictor(predictor.network, source_px=predictor.source_px, device=device)
    outcome |= {"images": len(data.curves), "cpu_min": fitted.cpu_s / 60}
    return predictor, outcome | {f"{name}_after": value for name, value in errors(predictor, data).items()}


def errors(predictor: Predictor, data: WirePictures) -> dict[str, float]:
    """Mean and median error of tip and curve of the held-out pictures, in px of an image of 1,024; {} without any."""
    places: Sequence[int] = np.flatnonzero(data.held_out).tolist()
    if not places:
        return {}
    readings = PerceptionNetwork(predictor)(list(data.pictures[places]))
    distances = [
        curve_errors(1024.0 * reading.points.astype(float), 1024.0 * data.curves[place])
        for place, reading in zip(places, readings, strict=True)
    ]
    values = {name: [one[name] for one in distances] for name in ("tip_px", "mean_px")}
    means = {name: float(np.mean(of)) for name, of in values.items()}
    return means | {f"median_{name}": float(np.median(of)) for name, of in values.items()}
