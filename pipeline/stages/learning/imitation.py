"""Imitation jobs: one student from the expert's episodes to its own logged ones.

A student's folder, ``<phantom>/<target>/<row>/seed<k>/``, holds::

    policy.pt  training.csv  training.json
    evaluation/{deterministic,stochastic}/NNN.mcap
    fit/                                          checkpoint, until the student is fitted
"""

from __future__ import annotations

import csv
import functools
import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.jobs.job import OPTIMISER
from pipeline.jobs.worker import Report
from pipeline.recording.curves import Curves
from pipeline.recording.trials import POLICY, Origin, controllers
from pipeline.seeds import disturbed_seeds
from pipeline.stages.learning.evaluation import both_modes, evaluate
from pipeline.stages.learning.expert_episodes import expert_logs, load_expert, read_episodes
from pipeline.stages.learning.task import LearningTask
from pipeline.stages.learning.training import CURVE, RECORD
from pipeline.store.atomic_files import atomic_path, write_json
from pipeline.task import TASK

if TYPE_CHECKING:
    from enn.imitation.behaviour_cloning import BehaviourCloningSettings
    from enn.imitation.cloned_policy import ClonedPolicy
    from enn.imitation.dagger import DaggerSettings

PRELOAD = ("cathsim", "enn.imitation.distillation", "enn.policy", "pipeline.recording.record", OPTIMISER)
_FITTING = 0.6  # share of a job's time


@dataclass(frozen=True)
class ImitationJob:
    """A student to fit and to evaluate."""

    folder: Path
    origin: Origin  # row, seed of the fit and variant; kept in the logs
    settings: BehaviourCloningSettings
    task: LearningTask
    expert: Path  # folder of the expert's training, with its policy and episodes
    episodes: int  # of the expert to learn from
    evaluation_episodes: int  # by the best action
    drawn_episodes: int  # by drawn actions
    disturbed_episodes: int = 0  # further ones with disturbed actions
    rounds: DaggerSettings | None = None  # of DAgger; None: none


def imitate(job: ImitationJob, report: Report) -> dict[str, Any]:
    """Fits a student and evaluates it on held-out seeds; each part only where it lacks.

    Returns:
        ``samples``, ``episodes``, ``rounds``, ``cpu_s`` and the summaries of both modes.
    """
    from enn.imitation.cloned_policy import ClonedPolicy

    record = job.folder / RECORD
    if (job.folder / POLICY).is_file() and record.is_file():
        student = ClonedPolicy.load(job.folder / POLICY, report.device)
        outcome = json.loads(record.read_text(encoding="utf-8"))
    else:
        student, outcome = _student(job, report)
    environment = job.task.environment(student.keys)
    policies = functools.partial(controllers, student)
    outcome |= evaluate(
        environment,
        policies,
        job.folder,
        job.origin,
        both_modes(job.evaluation_episodes, job.drawn_episodes),
        report.part(_FITTING, 1.0),
    )
    environment.close()
    return outcome


def _student(job: ImitationJob, report: Report) -> tuple[ClonedPolicy, dict[str, Any]]:
    """Fits the student and keeps it with a record of the fit."""
    from enn.imitation.distillation import distil

    began, worked, seed = time.monotonic(), time.process_time(), job.origin.training_seed
    distilled = distil(
        load_expert(job.expert, report.device),
        read_episodes(expert_logs(job.expert), job.episodes),
        job.settings,
        functools.partial(job.task.environment, training=True),
        disturbed_seeds=disturbed_seeds(seed, job.disturbed_episodes),
        rounds=job.rounds,
        seed=seed,
        folder=job.folder / "fit",
        progress=report.part(0.0, _FITTING),
        device=report.device,
    )
    student = distilled.student
    student.metadata |= {
        "phantom": job.task.phantom,
        "target": job.task.target,
        "seed": seed,
        "row": job.origin.row,
        TASK: asdict(job.task.task),
    }
    outcome = {
        "episodes": distilled.episodes,
        "samples": distilled.samples,
        "rounds": [
            {"episodes": one.episodes, "success_pct": 100 * one.success, "disagreement": one.disagreement}
            for one in distilled.rounds
        ],
        "training_s": time.monotonic() - began,
        "cpu_s": time.process_time() - worked,
        "seed": seed,
    }
    with atomic_path(job.folder / CURVE) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        table = csv.DictWriter(stream, ("epoch", "loss", "validation", "cpu_s"))
        table.writeheader()
        table.writerows(distilled.fit.rows)
    with Curves(job.folder) as curves:
        curves.add_epochs(distilled.fit.rows)
    student.save(job.folder / POLICY)
    write_json(job.folder / RECORD, outcome)
    return student, outcome
