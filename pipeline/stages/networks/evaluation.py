"""Network jobs: a network of guide3d is trained, then evaluated on acquisitions it has never seen."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.jobs.job import OPTIMISER
from pipeline.jobs.worker import Report
from pipeline.stages.guide3d.folder import open_dataset
from pipeline.stages.networks.training import PREDICTOR, TrainingJob, train, training_figures
from pipeline.store.atomic_files import atomic_path, write_json

if TYPE_CHECKING:
    from guide3d.dataset.dataset import Dataset

PRELOAD = ("guide3d.train", "guide3d.learning.evaluation", OPTIMISER)
EXAMPLES = "examples.npz"

# predictor, figures and examples of a trained network, from its job, the data set and the test acquisitions
_Evaluate = Callable[[TrainingJob, "Dataset", tuple[str, ...], Report], tuple[Any, dict[str, Any], dict[str, Any]]]


def learn_shape(job: TrainingJob, report: Report) -> dict[str, Any]:
    """Trains a network of the shape and compares its curves with the true ones; see `evaluate_shape`."""
    return _learn(job, report, job.folder / "shape.json", _evaluate_shape, np.savez)


def learn_segmentation(job: TrainingJob, report: Report) -> dict[str, Any]:
    """Trains a segmentation network and compares its masks with the annotated ones; see `evaluate_segmentation`."""
    return _learn(job, report, job.folder / "segmentation.json", _evaluate_segmentation, np.savez_compressed)


def _learn(
    job: TrainingJob, report: Report, file: Path, evaluate: _Evaluate, save: Callable[..., None]
) -> dict[str, Any]:
    if not file.is_file():
        from guide3d.dataset.dataset import split

        training = train_network(job, report)
        data = open_dataset(job.guide3d)
        test = split(data, seed=job.settings.split_seed).test
        predictor, figures, examples = evaluate(job, data, test, report)
        with atomic_path(job.folder / EXAMPLES) as temporary:
            save(temporary, **examples)
        trained_with = {name: int(n) for name, n in predictor.metadata.items() if name.startswith("training_")}
        figures |= training_figures(training, predictor) | trained_with | {"acquisitions": len(test)}
        write_json(file, figures)
    return dict(json.loads(file.read_text(encoding="utf-8")))


def train_network(job: TrainingJob, report: Report) -> dict[str, Any]:
    """Trains a network, or goes on with its training; returns what ``training.json`` holds."""
    words = ["--network", job.network]
    if getattr(job.settings, "pretrained", None) is not None and job.network != "fgrn":  # that has no transformer
        words += ["--pretrained", job.settings.pretrained]
    return train("guide3d.train", job, words, ("images", "calibration", "curves"), report)


def _evaluate_shape(job: TrainingJob, data: Dataset, test: tuple[str, ...], report: Report) -> Any:
    from guide3d.learning.evaluation import evaluate_shape
    from guide3d.learning.predictor import FGRNPredictor, ShapePredictor

    kind: Any = FGRNPredictor if job.network == "fgrn" else ShapePredictor
    predictor = kind.load(job.folder / PREDICTOR, report.device)
    return predictor, *evaluate_shape(predictor, data, test, job.pictures)


def _evaluate_segmentation(job: TrainingJob, data: Dataset, test: tuple[str, ...], report: Report) -> Any:
    from guide3d.learning.evaluation import evaluate_segmentation
    from guide3d.learning.predictor import SegmentationPredictor

    def progress(number: int, of: int) -> None:
        report(0.9 + 0.1 * number / of, f"image {number + 1} of {of}")

    predictor = SegmentationPredictor.load(job.folder / PREDICTOR, report.device)
    return predictor, *evaluate_segmentation(predictor, data, test, job.settings.test_images, job.pictures, progress)
