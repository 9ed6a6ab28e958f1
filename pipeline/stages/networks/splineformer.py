"""Training jobs of SplineFormer: one variant, and what it is like alone."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.jobs.worker import Report
from pipeline.stages.guide3d.folder import open_dataset
from pipeline.stages.networks.training import PREDICTOR, TrainingJob, train
from pipeline.store.atomic_files import write_json

if TYPE_CHECKING:
    from guide3d.dataset.dataset import Dataset
    from splineformer.predictor import Predictor

PRELOAD = (
    "splineformer.train",
    "splineformer.comparison.skeleton",
    "guide3d.learning.predictor",
    "guide3d.learning.segmentation_metrics",
)
RECORD = "variant.json"
_BATCH = 8
_TIMED = 5  # calls, after one that is not counted
_KINDS_OF = 48  # test images whose kind is asked for, in each of the four forms
_TRIPS = 400  # curves that go to tokens and back


@dataclass(frozen=True, kw_only=True)
class VariantJob(TrainingJob):
    """A variant, "published" or "ordered", to train and to measure.

    Attributes:
        tensorboard: write the losses for it, too.
    """

    tensorboard: bool = False


def learn_variant(job: VariantJob, report: Report) -> dict[str, Any]:
    """Trains a variant and measures what needs no rival.

    Args:
        job: what to train.
        report: takes the progress.

    Returns:
        Size, cost and speed of the network, its losses, how curves survive as tokens, and whether the kind of an image
        is told.
    """
    file = job.folder / RECORD
    if file.is_file():
        return dict(json.loads(file.read_text(encoding="utf-8")))
    words = ["--variant", job.network, *(["--tensorboard"] if job.tensorboard else [])]
    training = train("splineformer.train", job, words, ("images", "calibration"), report)
    from splineformer.predictor import Predictor

    data = open_dataset(job.guide3d)
    predictor = Predictor.load(job.folder / PREDICTOR, device=report.device)
    report(0.92, "speed")
    outcome = {
        "variant": job.network,
        "parameters": sum(weight.numel() for weight in predictor.network.parameters()),
        "image_px": predictor.network.settings.image_px,
        "epochs": len(training["rows"]),
        "best_epoch": training["best_epoch"],
        "cpu_min": training["rows"][-1]["cpu_s"] / 60,
        "curve": [[row["epoch"], row["loss"], row["validation"]] for row in training["rows"]],
        **speed(Predictor.load(job.folder / PREDICTOR), data),
        **round_trips(predictor, data, job.seed),
        **kinds_told(predictor, data, job, report),
    }
    write_json(file, outcome)
    return outcome


def speed(predictor: Predictor, data: Dataset) -> dict[str, float]:
    """Processor time of one image, and images a second in batches of eight, from the camera's image to the curve."""
    image = data.frames[0].image("a")
    told = {}
    for name, images in (("latency_ms", [image]), ("batch_ms", [image] * _BATCH)):
        predictor.batch(images)
        began = time.process_time()
        for _ in range(_TIMED):
            predictor.batch(images)
        told[name] = 1e3 * (time.process_time() - began) / _TIMED
    return {"latency_ms": told["latency_ms"], "images_per_s": 1e3 * _BATCH / told["batch_ms"]}


def round_trips(predictor: Predictor, data: Dataset, seed: int) -> dict[str, float]:
    """Mean error of annotated curves that become tokens of the variant's form and curves again; number of tokens."""
    from splineformer.tokens import round_trip_px

    draws = np.random.default_rng(seed).permutation(len(data.frames))[:_TRIPS]
    errors, counts = [], []
    for number, index in enumerate(draws.tolist()):
        points = data.frames[index].polyline("ab"[number % 2])
        tokens = predictor.network.fit_tokens(points)
        errors.append(round_trip_px(points, tokens))
        counts.append(len(tokens))
    return {"round_trip_px": float(np.mean(errors)), "tokens_mean": float(np.mean(counts)), "tokens_max": max(counts)}


def kinds_told(predictor: Predictor, data: Dataset, job: VariantJob, report: Report) -> dict[str, float]:
    """Shares (%) of test images whose kind is told: one wire, none (taken away), two (one added), inverted levels."""
    from guide3d.dataset.dataset import VIEWS, images_of, split
    from splineformer.image_input import picture_of, shares_of_pixels

    items = images_of(data, split(data, seed=job.split_seed).test, _KINDS_OF)
    generator = np.random.default_rng(job.seed)
    right = {"one": 0, "none": 0, "several": 0, "inverted": 0}
    former = None
    for number, item in enumerate(items.tolist()):
        report(0.94 + 0.05 * number / len(items), "kinds of image")
        camera, index = divmod(item, len(data.frames))
        frame = data.frames[index]
        image = frame.image(VIEWS[camera])
        small = picture_of(image, predictor.network.settings.image_px, len(image)).pixels
        wire = shares_of_pixels(frame.polyline(VIEWS[camera]), (image.shape[1], image.shape[0]))
        empty, former = _without_and_with(small, wire, generator, former)
        plain, none, several, inverted = predictor.batch([small, empty[0], empty[1], 255 - small])
        right["one"] += plain.wires == "one" and not plain.inverted
        right["none"] += none.wires == "none"
        right["several"] += several.wires == "several"
        right["inverted"] += inverted.inverted
    return {f"told_{name}_pct": 100.0 * count / len(items) for name, count in right.items()}


def _without_and_with(
    small: np.ndarray, wire: np.ndarray, generator: np.random.Generator, former: Any
) -> tuple[tuple[np.ndarray, np.ndarray], Any]:
    """The picture without its wire, and with the mirrored wire of the picture before (its own for the first)."""
    import torch

    from splineformer.learning.augmentation import shadow, without_wire

    image = torch.from_numpy(small.astype(np.float32))[None]
    empty = without_wire(image, wire, generator)
    own = shadow(image, empty).flip(1)
    double = image * (own if former is None else former)
    return (_levels(empty), _levels(double)), own


def _levels(image: Any) -> np.ndarray:
    return np.asarray(image[0].clamp(0, 255).round().numpy().astype(np.uint8))
