"""Network jobs: a training by a package's own command line, then tests on unseen acquisitions."""

from __future__ import annotations

import importlib
import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from enn.curves import Curves
from pipeline.jobs.pool import Job, run_jobs
from pipeline.jobs.worker import OPTIMISER, Report
from pipeline.settings.kinds import settings_that_matter
from pipeline.stages import StageContext
from pipeline.stages.guide3d.folder import open_dataset, read_source
from pipeline.stages.guide3d.settings import Guide3dSettings
from pipeline.stages.job_memory import network_gb
from pipeline.stages.networks.settings import SEGMENTATION_ROWS, SHIPPED, ShippedSettings, TrainingSettings
from pipeline.store.atomic_files import atomic_path, read_json, write_json
from pipeline.store.manifest import read_manifest
from pipeline.tables import Figure, Results

if TYPE_CHECKING:
    from guide3d.dataset.dataset import Dataset
    from guide3d.learning.training import FitProgress


PREDICTOR, TRAINING = "predictor.pt", "training.json"


@dataclass(frozen=True)
class TrainingJob:
    """A training by a package's own command line."""

    folder: Path
    guide3d: Path  # folder of the stage guide3d, which knows the data set
    pictures: Path  # folder of prepared pictures, which trainings share
    network: str  # as the command line calls it
    settings: Any  # of the stage; `TrainingSettings` and what the stage adds to them
    seed: int
    shipped: str | None = None  # network that is taken in place of the training


def train(module: str, job: TrainingJob, words: Sequence[str], places: Sequence[str], report: Report) -> dict[str, Any]:
    """Trains a network or goes on with it; gives ``training.json``."""
    table = job.folder / TRAINING
    if job.shipped is not None and not table.is_file():
        _take(job, job.shipped)
    if table.is_file() and (job.folder / PREDICTOR).is_file():
        return dict(read_json(table))
    settings = job.settings
    source = read_source(job.guide3d)
    words = [
        str(job.guide3d / source.root), *words, "--size", settings.size, "--output", str(job.folder),
        "--pictures", str(job.pictures), "--device", report.device, "--seed", str(job.seed),
        "--split-seed", str(settings.split_seed),
    ]  # fmt: skip
    for name in places:
        path = source.place(job.guide3d, name)
        if path is not None:
            words += [f"--{name}", str(path)]
    if settings.epochs:
        words += ["--epochs", str(settings.epochs)]
    command = importlib.import_module(module)

    def tell(now: FitProgress) -> None:
        curves.add(now.epoch, loss=now.loss, validation=now.validation)
        loss = now.loss if now.validation is None else now.validation
        report(0.9 * now.epoch / now.epochs, f"epoch {now.epoch}, validation {loss:.3g}")

    with Curves(job.folder) as curves:
        return dict(command.train_command(command.arguments(words), progress=tell))


def _take(job: TrainingJob, shipped: str) -> None:
    """Leaves a shipped network, and the table of its training, as a training here would."""
    from guide3d.learning.model_file import read_content
    from guide3d.shipped import shipped_file

    with shipped_file(shipped, SHIPPED[job.settings.name][0]) as path, atomic_path(job.folder / PREDICTOR) as temporary:
        training = json.loads(read_content(path)["metadata"]["training"])
        shutil.copyfile(path, temporary)
    write_json(job.folder / TRAINING, training)


def training_figures(training: dict[str, Any], predictor: Any) -> dict[str, Any]:
    """Size of a predictor's network, and its training, from the table in ``training.json``."""
    rows = training["rows"]
    return {
        "parameters": sum(weight.numel() for weight in predictor.network.parameters()),
        "epochs": len(rows),
        "best_epoch": training["best_epoch"],
        "cpu_min": rows[-1]["cpu_s"] / 60,
    }


PICTURES = ".cache/pictures"  # made again from the data set when needed


def shipped_rows(settings: ShippedSettings, context: StageContext) -> dict[str, str]:
    """Row to shipped network, of those that a training here would repeat: data set, size, split and seed agree."""
    data = read_manifest(context.inputs["guide3d"])
    same = (settings.size, settings.epochs, settings.split_seed, context.seed) == ("desk", 0, 0, 0)
    if not (settings.shipped and same and data is not None):
        return {}
    _, row, name = SHIPPED[settings.name]
    usual = settings_that_matter(Guide3dSettings())
    return {row: name} if {key: data.config.get(key) for key in usual} == usual else {}


def training_job(
    network: str,
    learn: Callable[[TrainingJob, Any], Any],
    settings: TrainingSettings,
    context: StageContext,
    shipped: str | None = None,
) -> Job:
    """The job that trains one network, named and with a folder after it."""
    learn_job = TrainingJob(
        folder=context.path / network,
        guide3d=context.inputs["guide3d"],
        pictures=context.path / PICTURES,
        network=network,
        settings=settings,
        seed=context.seed,
        shipped=shipped,
    )
    gpu_gb = network_gb(network, settings.size)
    return Job(network, learn, learn_job, gpu_gb=gpu_gb)


def cost_cells(outcome: dict[str, Any]) -> dict[str, Any]:
    """A network's size in millions of weights, and its training in epochs and minutes of processor time."""
    return {"parameters_m": outcome["parameters"] / 1e6, "epochs": outcome["epochs"], "cpu_min": outcome["cpu_min"]}


def train_and_compare(
    settings: TrainingSettings,
    context: StageContext,
    jobs: Sequence[Job],
    tables: Callable[[Any, dict[str, Any]], dict[str, Any]],
    figures: Callable[[Any, dict[str, Any], StageContext], list[Figure]],
    *,
    label: str,
    preload: Sequence[str],
    labels: Mapping[str, str],
) -> Results:
    """Trains every network, makes tables and figures of settings and outcomes, and notes which rows were shipped."""
    outcomes = run_jobs(
        context.folder, list(jobs), workers=settings.workers, label=label, preload=preload, device=settings.device
    )
    measured = tables(settings, outcomes)
    text = " ".join(
        f"{labels[job.key]}: `{job.given.shipped}`, shipped with the package, its training not repeated here. Its "
        f"card (`{SHIPPED[job.given.settings.name][0]}.card`) has the command of the training; `make all PRETRAINED=0` "
        "trains."
        for job in jobs
        if isinstance(job.given, TrainingJob) and job.given.shipped is not None
    )
    notes = dict.fromkeys(measured, text) if text else {}
    return Results(measured, figures(settings, outcomes, context), notes)


PRELOAD = ("guide3d.train", "guide3d.learning.evaluation", OPTIMISER)
EXAMPLES = "examples.npz"


def learn(job: TrainingJob, report: Report) -> dict[str, Any]:
    """Trains a network and compares its curves, or masks, with the true ones; see `guide3d.learning.evaluation`."""
    segments = job.network in SEGMENTATION_ROWS
    file = job.folder / ("segmentation.json" if segments else "shape.json")
    if not file.is_file():
        from guide3d.dataset.dataset import split

        training = train_network(job, report)
        data = open_dataset(job.guide3d)
        test = split(data, seed=job.settings.split_seed).test
        evaluate = _evaluate_segmentation if segments else _evaluate_shape
        predictor, figures, examples = evaluate(job, data, test, report)
        with atomic_path(job.folder / EXAMPLES) as temporary:
            (np.savez_compressed if segments else np.savez)(temporary, **examples)
        trained_with = {name: int(n) for name, n in predictor.metadata.items() if name.startswith("training_")}
        figures |= training_figures(training, predictor) | trained_with | {"acquisitions": len(test)}
        write_json(file, figures)
    return dict(read_json(file))


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
