"""Figures of a predictor on random fluoroscopy: curve, tip, and what is missed or found where there is nothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from guide3d.geometry.polyline import Array, arc_length, at_length, distances_to, resample
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy, RandomImage
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from splineformer.comparison.evaluation import Image
from splineformer.image_input import pixels_of_shares
from splineformer.learning.fluoroscopy_pool import NONE, ONE, curve_of
from splineformer.predictor import Predictor

TEST_SEED = 1_000_003  # of random images on which nothing was chosen: their indices differ from those of validation
TEST_FIRST = 30_000
IN_ORDER_PX = 10.0
_SHARES = 100

CurveFinder = Callable[[Image], Array | None]  # (h, w) uint8 to (n, 2) px, tip first; None: no wire


def finder(predictor: Predictor) -> CurveFinder:
    """Finds curves by a SplineFormer."""

    def find(image: Image) -> Array | None:
        prediction = predictor(image)
        return None if prediction.tokens is None else prediction.points()

    return find


def evaluate_on_fluoroscopy(
    predictor: Predictor, settings: FluoroscopySettings, images: int, first: int = TEST_FIRST
) -> dict[str, Any]:
    """Figures on random images of the test's seed: see `summary`."""
    fluoroscopy = RandomFluoroscopy(settings, TEST_SEED)
    find = finder(predictor)
    rows = []
    for index in range(first, first + images):
        drawn = fluoroscopy.image(index)
        rows.append(figures_of(drawn, find(drawn.image)))
    return summary(rows)


def figures_of(drawn: RandomImage, found: Array | None) -> dict[str, Any]:
    """Figures of one random image: `curve_figures` where it shows one wire whose tip is seen, and what was found."""
    wires, curve = curve_of(drawn)
    row: dict[str, Any] = {"wires": wires, "measured": wires == ONE and curve is not None, "found": found is not None}
    if curve is None or found is None or wires != ONE:
        return row
    side = len(drawn.image)
    return row | curve_figures(found, pixels_of_shares(curve, (side, side)))


def curve_figures(found: Array, true: Array) -> dict[str, float]:
    """Distances of a curve that was found from the true one, px; both (n, 2) px, tip first.

    Returns:
        "curve_px", the mean distance of the true curve's points from the curve found; "order_px", the mean distance at
        equal shares of both lengths; "tip_px", the distance of the first points.
    """
    truth = resample(true, spacing=1.0)
    share = np.linspace(0.0, 1.0, _SHARES)
    apart = at_length(found, share * arc_length(found)[-1]) - at_length(truth, share * arc_length(truth)[-1])
    return {
        "curve_px": float(distances_to(found, truth).mean()),
        "order_px": float(np.hypot(*apart.T).mean()),
        "tip_px": float(np.hypot(*(found[0] - truth[0]))),
    }


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Sums up rows of `figures_of`.

    Returns:
        Medians over the images whose wire was found ("curve_median_px", ...); "in_order", the share of all images with
        one wire whose curve is less than 10 px off at equal shares of both lengths; "missed", of those; "empty",
        images without a wire, and "found_in_empty".
    """
    measured = [row for row in rows if row["measured"]]
    found = [row for row in measured if row["found"]]
    empty = [row for row in rows if row["wires"] == NONE]
    medians = {
        f"{name}_median_px": float(np.median([row[f"{name}_px"] for row in found])) if found else None
        for name in ("curve", "order", "tip")
    }
    in_order = [row["found"] and row["order_px"] <= IN_ORDER_PX for row in measured]
    return {
        "images": len(measured),
        **medians,
        "in_order": float(np.mean(in_order)) if in_order else None,
        "missed": len(measured) - len(found),
        "empty": len(empty),
        "found_in_empty": sum(row["found"] for row in empty),
    }
