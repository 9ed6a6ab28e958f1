"""Figures of a predictor: on random fluoroscopy, and of its variant alone."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from guide3d.dataset.dataset import Dataset
from guide3d.geometry.polyline import Array, arc_length, at_length, distances_to, resample
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy, RandomImage
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from splineformer.comparison.evaluation import Image, frame_of
from splineformer.image_input import picture_of, pixels_of_shares, shares_of_pixels
from splineformer.learning.augmentation import shadow, without_wire
from splineformer.learning.fluoroscopy_samples import NONE, ONE, curve_of
from splineformer.predictor import Predictor
from splineformer.tokens import round_trip_px

TEST_SEED = 1_000_003  # of random images on which nothing was chosen: their indices differ from those of validation
TEST_FIRST = 30_000
IN_ORDER_PX = 10.0
_SHARES = 100

CurveFinder = Callable[[Image], Array | None]  # (h, w) uint8 to (n, 2) px, tip first; None: no wire


_BATCH = 8
_TIMED_S = 2.0  # processor time after which no further call is timed


def finder(predictor: Predictor) -> CurveFinder:
    """Finds curves by a SplineFormer."""

    def find(image: Image) -> Array | None:
        prediction = predictor(image)
        return None if prediction.tokens is None else prediction.points()

    return find


def evaluate_on_fluoroscopy(predictor: Predictor, settings: FluoroscopySettings, images: int) -> dict[str, Any]:
    """Figures on random images of the test's seed: see `summary`."""
    fluoroscopy = RandomFluoroscopy(settings, TEST_SEED)
    find = finder(predictor)
    rows = []
    for index in range(TEST_FIRST, TEST_FIRST + images):
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


def curve_figures(curve: Array, true: Array) -> dict[str, float]:
    """Distances of a curve that was found from the true one, px; both (n, 2) px, tip first.

    Returns:
        "curve_px", the mean distance of the true curve's points from the curve found; "order_px", the mean distance at
        equal shares of both lengths; "tip_px", the distance of the first points.
    """
    truth = resample(true, spacing=1.0)
    share = np.linspace(0.0, 1.0, _SHARES)
    apart = at_length(curve, share * arc_length(curve)[-1]) - at_length(truth, share * arc_length(truth)[-1])
    return {
        "curve_px": float(distances_to(curve, truth).mean()),
        "order_px": float(np.hypot(*apart.T).mean()),
        "tip_px": float(np.hypot(*(curve[0] - truth[0]))),
    }


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Sums up rows of `figures_of`.

    Returns:
        Medians over the images whose wire was found ("curve_median_px", ...); "in_order", the share of all images with
        one wire whose curve is less than 10 px off at equal shares of both lengths; "missed", of those; "empty",
        images without a wire, and "found_in_empty".
    """
    measured = [row for row in rows if row["measured"]]
    with_curve = [row for row in measured if row["found"]]
    empty = [row for row in rows if row["wires"] == NONE]
    medians = {
        f"{name}_median_px": float(np.median([row[f"{name}_px"] for row in with_curve])) if with_curve else None
        for name in ("curve", "order", "tip")
    }
    in_order = [row["found"] and row["order_px"] <= IN_ORDER_PX for row in measured]
    return {
        "images": len(measured),
        **medians,
        "in_order": float(np.mean(in_order)) if in_order else None,
        "missed": len(measured) - len(with_curve),
        "empty": len(empty),
        "found_in_empty": sum(row["found"] for row in empty),
    }


def speed(predictor: Predictor, image: NDArray[np.uint8], calls: int = 5) -> dict[str, float]:
    """Processor time of one image, and images a second in batches of eight, from the camera's image to the curve.

    Args:
        calls: timed at most, after one that is not; of a slow network fewer, as many as begin within two seconds.
    """

    def call_ms(images: list[NDArray[np.uint8]]) -> float:
        predictor.batch(images)
        began, timed, spent = time.process_time(), 0, 0.0
        while timed < calls and spent < _TIMED_S:
            predictor.batch(images)
            timed, spent = timed + 1, time.process_time() - began
        return 1e3 * spent / timed

    return {"latency_ms": call_ms([image]), "images_per_s": 1e3 * _BATCH / call_ms([image] * _BATCH)}


def round_trips(fit_tokens: Callable[[Array], Array], curves: Sequence[Array]) -> dict[str, float]:
    """Mean and largest error of curves that become tokens and curves again, and the number of tokens.

    Args:
        fit_tokens: of a network: `CurveNetwork.fit_tokens`.
        curves: (n, 2) px each, tip first.
    """
    tokens = [fit_tokens(points) for points in curves]
    errors = [round_trip_px(points, fitted) for points, fitted in zip(curves, tokens, strict=True)]
    return {
        "round_trip_px": float(np.mean(errors)),
        "round_trip_max_px": float(np.max(errors)),
        "tokens_mean": float(np.mean([len(one) for one in tokens])),
        "tokens_max": max(len(one) for one in tokens),
    }


def kind_accuracy(
    predictor: Predictor,
    data: Dataset,
    items: Sequence[int],
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, float]:
    """Shares (%) of images whose kind is recognised: "one" wire, "none" (removed), "several" (one added), "inverted".

    Args:
        items: images; the added wire is the mirrored one of the image before (its own for the first).
        seed: of the noise where a wire was removed.
        progress: called with the number of an image and of all, before each.
    """
    generator = np.random.default_rng(seed)
    right = {"one": 0, "none": 0, "several": 0, "inverted": 0}
    former = None
    for number, item in enumerate(items):
        if progress is not None:
            progress(number, len(items))
        frame, camera = frame_of(data, item)
        image = frame.image(camera)
        small = picture_of(image, predictor.network.settings.image_px, len(image)).pixels
        wire = shares_of_pixels(frame.polyline(camera), (image.shape[1], image.shape[0]))
        levels = torch.from_numpy(small.astype(np.float32))[None]
        empty = without_wire(levels, wire, generator)
        own = shadow(levels, empty).flip(1)
        double = levels * (own if former is None else former)
        former = own
        pictures = [small, _grey(empty), _grey(double), 255 - small]
        plain, none, several, inverted = predictor.batch(pictures)
        right["one"] += plain.wires == "one" and not plain.inverted
        right["none"] += none.wires == "none"
        right["several"] += several.wires == "several"
        right["inverted"] += inverted.inverted
    return {name: 100.0 * count / len(items) for name, count in right.items()}


def _grey(levels: torch.Tensor) -> NDArray[np.uint8]:
    return np.asarray(levels[0].clamp(0, 255).round().numpy().astype(np.uint8))
