"""Figures of one variant alone: its speed, how curves survive as its tokens, and whether it knows the kind of image."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from guide3d.dataset.dataset import Dataset
from guide3d.geometry.polyline import Array
from splineformer.comparison.evaluation import frame_of
from splineformer.image_input import picture_of, shares_of_pixels
from splineformer.learning.augmentation import shadow, without_wire
from splineformer.predictor import Predictor
from splineformer.tokens import round_trip_px

_BATCH = 8
_TIMED_S = 2.0  # processor time after which no further call is timed


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
