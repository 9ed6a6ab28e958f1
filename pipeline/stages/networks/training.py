"""Network jobs: one training, in this process or by torchrun in several, through a package's own command line."""

from __future__ import annotations

import importlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.jobs.worker import Report
from pipeline.recording.curves import Curves
from pipeline.stages.guide3d.folder import read_source
from pipeline.stages.networks.torchrun import train_together
from pipeline.store.written_files import note

if TYPE_CHECKING:
    from guide3d.learning.training import FitProgress

PREDICTOR, TRAINING = "predictor.pt", "training.json"


@dataclass(frozen=True)
class TrainingJob:
    """A training by a package's own command line.

    Attributes:
        guide3d: folder of the stage guide3d, which knows the data set.
        pictures: folder of prepared pictures, which trainings share.
        network: as the command line calls it.
        settings: of the stage; `TrainingSettings` and what the stage adds to them.
    """

    folder: Path
    guide3d: Path
    pictures: Path
    network: str
    settings: Any
    seed: int


def train(module: str, job: TrainingJob, words: Sequence[str], places: Sequence[str], report: Report) -> dict[str, Any]:
    """Trains a network or goes on with it, here or by torchrun in several processes; returns ``training.json``'s table.

    Args:
        module: with the command line's ``arguments`` and ``train``.
        words: of the command line that only this module has.
        places: of the data set that it takes.
    """
    table = job.folder / TRAINING
    if table.is_file() and (job.folder / PREDICTOR).is_file():
        return dict(json.loads(table.read_text(encoding="utf-8")))
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
    if settings.processes > 1:
        train_together(module, words, settings.processes, report)
        note(*(file for file in job.folder.rglob("*") if file.is_file()))
        trained = dict(json.loads(table.read_text(encoding="utf-8")))
        with Curves(job.folder) as curves:
            curves.add_epochs(trained["rows"])
        return trained
    command = importlib.import_module(module)

    def tell(now: FitProgress) -> None:
        curves.add(now.epoch, loss=now.loss, validation=now.validation)
        loss = now.loss if now.validation is None else now.validation
        report(0.9 * now.epoch / now.epochs, f"epoch {now.epoch}, validation {loss:.3g}")

    with Curves(job.folder) as curves:
        return dict(command.train(command.arguments(words), progress=tell))


def training_figures(training: dict[str, Any], predictor: Any) -> dict[str, Any]:
    """Size of a predictor's network, and its training, from the table in ``training.json``."""
    rows = training["rows"]
    return {
        "parameters": sum(weight.numel() for weight in predictor.network.parameters()),
        "epochs": len(rows),
        "best_epoch": training["best_epoch"],
        "cpu_min": rows[-1]["cpu_s"] / 60,
        "curve": [[row["epoch"], row["loss"], row["validation"]] for row in rows],
    }
