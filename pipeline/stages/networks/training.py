"""Network jobs: one training, in this process or by torchrun in several, through a package's own command line."""

from __future__ import annotations

import importlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.jobs.worker import Report
from pipeline.stages.guide3d.folder import read_source
from pipeline.stages.networks.torchrun import train_together
from pipeline.store.written_files import note

if TYPE_CHECKING:
    from guide3d.learning.training import FitProgress

PREDICTOR, TRAINING = "predictor.pt", "training.json"


@dataclass(frozen=True, kw_only=True)
class TrainingJob:
    """A training by a package's own command line.

    Attributes:
        folder: of the network.
        guide3d: folder of the stage guide3d, which knows the data set.
        pictures: folder of prepared pictures, which trainings share.
        network: as the command line calls it.
        size: of its recipe.
        epochs: 0: the recipe's own.
        split_seed: of the split.
        seed: of the training.
        processes: that train together.
    """

    folder: Path
    guide3d: Path
    pictures: Path
    network: str
    size: str
    epochs: int
    split_seed: int
    seed: int
    processes: int = 1


@dataclass(frozen=True, kw_only=True)
class NetworkJob(TrainingJob):
    """A network of `guide3d.train` to train and to judge.

    Attributes:
        pretrained: weights of a vision transformer.
        test_images: that it is judged by; 0: all.
    """

    pretrained: str | None = None
    test_images: int = 0


def train_network(job: NetworkJob, report: Report) -> dict[str, Any]:
    """Trains a network, or goes on with its training; the table of the training, as ``training.json`` has it."""
    words = ["--network", job.network]
    if job.pretrained is not None:
        words += ["--pretrained", job.pretrained]
    return train("guide3d.train", job, words, ("images", "calibration", "curves"), report)


def train(module: str, job: TrainingJob, words: Sequence[str], places: Sequence[str], report: Report) -> dict[str, Any]:
    """Trains a network, or goes on with its training: in this process, or by torchrun in several.

    Args:
        module: with the command line's ``arguments`` and ``train``.
        job: what to train.
        words: of the command line that only this module has.
        places: of the data set that it takes.
        report: takes the progress.

    Returns:
        The table of the training, as ``training.json`` has it.
    """
    told = job.folder / TRAINING
    if told.is_file() and (job.folder / PREDICTOR).is_file():
        return dict(json.loads(told.read_text(encoding="utf-8")))
    source = read_source(job.guide3d)
    words = [
        str(job.guide3d / source.root), *words, "--size", job.size, "--output", str(job.folder),
        "--pictures", str(job.pictures), "--device", report.device, "--seed", str(job.seed),
        "--split-seed", str(job.split_seed),
    ]  # fmt: skip
    for name in places:
        path = source.place(job.guide3d, name)
        if path is not None:
            words += [f"--{name}", str(path)]
    if job.epochs:
        words += ["--epochs", str(job.epochs)]
    if job.processes > 1:
        train_together(module, words, job.processes, report)
        note(*(file for file in job.folder.rglob("*") if file.is_file()))
        return dict(json.loads(told.read_text(encoding="utf-8")))
    command = importlib.import_module(module)

    def tell(now: FitProgress) -> None:
        loss = now.loss if now.validation is None else now.validation
        report(0.9 * now.epoch / now.epochs, f"epoch {now.epoch}, validation {loss:.3g}")

    return dict(command.train(command.arguments(words), progress=tell))
