"""Jobs of SplineFormer: a variant is trained and measured alone, then all are compared with a traced segmentation."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.jobs.job import OPTIMISER
from pipeline.jobs.worker import Report
from pipeline.stages.guide3d.folder import open_dataset
from pipeline.stages.networks.settings import SplineformerSettings
from pipeline.stages.networks.training import PREDICTOR, TrainingJob, train, training_figures
from pipeline.store.atomic_files import atomic_path, write_json
from pipeline.store.errors import StageError

if TYPE_CHECKING:
    from guide3d.dataset.dataset import Dataset
    from splineformer.comparison.evaluation import Reader

PRELOAD = (
    "splineformer.learning.training_command",
    "splineformer.comparison.fluoroscopy_figures",
    "guide3d.learning.predictor",
    OPTIMISER,
)
RECORD, EXAMPLES = "variant.json", "examples.npz"
_KINDS_OF = 48  # test images whose kind is asked for, in each of the four forms
_TRIPS = 400  # curves that go to tokens and back


def learn_variant(job: TrainingJob, report: Report) -> dict[str, Any]:
    """Trains a variant and measures what needs no rival.

    Returns:
        Size, cost and speed of the network, its losses, how curves survive as tokens, and whether the kind of an image
        is recognised.
    """
    file = job.folder / RECORD
    if file.is_file():
        return dict(json.loads(file.read_text(encoding="utf-8")))
    training = train(
        "splineformer.learning.training_command", job, ["--variant", job.network], ("images", "calibration"), report
    )
    from guide3d.dataset.dataset import images_of, split
    from splineformer.comparison.fluoroscopy_figures import kind_accuracy, round_trips, speed
    from splineformer.predictor import Predictor

    data = open_dataset(job.guide3d)
    predictor = Predictor.load(job.folder / PREDICTOR, device=report.device)
    report(0.92, "speed")
    draws = np.random.default_rng(job.seed).permutation(len(data.frames))[:_TRIPS].tolist()
    curves = [data.frames[index].polyline("ab"[number % 2]) for number, index in enumerate(draws)]
    trips = round_trips(predictor.network.fit_tokens, curves)
    items = images_of(data, split(data, seed=job.settings.split_seed).test, _KINDS_OF).tolist()

    def progress(number: int, of: int) -> None:
        report(0.94 + 0.05 * number / of, "kinds of image")

    outcome = {
        "variant": job.network,
        "image_px": predictor.network.settings.image_px,
        **training_figures(training, predictor),
        **speed(Predictor.load(job.folder / PREDICTOR), data.frames[0].image("a")),
        **{name: trips[name] for name in ("round_trip_px", "tokens_mean", "tokens_max")},
        **{
            f"recognised_{k}_pct": share
            for k, share in kind_accuracy(predictor, data, items, job.seed, progress).items()
        },
    }
    write_json(file, outcome)
    return outcome


@dataclass(frozen=True)
class ComparisonJob:
    """Readers to compare.

    Attributes:
        folder: gets a record a disturbance, and examples.
        rival: folder of the segmentation network.
    """

    folder: Path
    guide3d: Path
    variants: dict[str, Path]
    rival: Path
    settings: SplineformerSettings
    seed: int


def compare(job: ComparisonJob, report: Report) -> dict[str, Any]:
    """Lets every reader read the test images; returns disturbance to reader to its figures: see `evaluate_readers`."""
    from guide3d.dataset.dataset import images_of, split
    from splineformer.comparison.evaluation import evaluate_readers, example_arrays, examples_of
    from splineformer.predictor import Predictor

    settings, data = job.settings, open_dataset(job.guide3d)
    readers = readers_of(job, data, report.device)
    test = split(data, seed=settings.split_seed).test
    plain, disturbed = (images_of(data, test, n).tolist() for n in (settings.test_images, settings.disturbed_images))
    outcome: dict[str, Any] = {}
    for place, kind in enumerate(settings.disturbances):
        file = job.folder / f"{kind}.json"
        if not file.is_file():

            def progress(number: int, of: int, place: int = place, kind: str = kind) -> None:
                report((place + number / of) / len(settings.disturbances), f"{kind}: image {number + 1} of {of}")

            items = plain if kind == "none" else disturbed
            write_json(file, evaluate_readers(readers, data, items, kind, job.seed, progress))
        outcome[kind] = json.loads(file.read_text(encoding="utf-8"))
    if not (job.folder / EXAMPLES).is_file():
        chosen = examples_of(outcome["none"][settings.rival], plain, disturbed, settings.disturbances)
        networks = {name: Predictor.load(folder / PREDICTOR) for name, folder in job.variants.items()}
        with atomic_path(job.folder / EXAMPLES) as temporary:
            np.savez_compressed(temporary, **example_arrays(chosen, data, readers, networks, job.seed))
    return outcome


def readers_of(job: ComparisonJob, data: Dataset, device: str) -> dict[str, Reader]:
    """The rival and the variants, from their files.

    Raises:
        StageError: the rival has not been trained.
    """
    from guide3d.dataset.dataset import split
    from guide3d.learning.predictor import SegmentationPredictor
    from splineformer.comparison.evaluation import curve_reader, mask_reader
    from splineformer.predictor import Predictor

    file, rival = job.rival / PREDICTOR, job.settings.rival
    if not file.is_file():
        raise StageError(f"{file} is missing: let the stage segmentation train {rival}, or choose another rival")
    training = split(data, seed=job.settings.split_seed).train
    readers = {rival: mask_reader(SegmentationPredictor.load(file, device), data, training)}
    for name, folder in job.variants.items():
        readers[name] = curve_reader(Predictor.load(folder / PREDICTOR, device=device))
    return readers
