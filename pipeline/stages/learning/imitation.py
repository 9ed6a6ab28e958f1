"""Imitation jobs: one student from the expert's episodes to its own logged ones.

A student's folder, ``<phantom>/<target>/<row>/seed<k>/``, draws as::

    policy.pt  training.csv  training.json
    evaluation/{deterministic,stochastic}/NNN.mcap
    fit/                                          checkpoint, until the student is fitted
"""

from __future__ import annotations

import csv
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.jobs.worker import Report
from pipeline.recording.trials import MODES, Origin, controllers, run_trials, summary
from pipeline.seeds import disturbed_seeds, held_out_seeds
from pipeline.stages.learning.expert_episodes import expert_logs, load_expert, read_episodes
from pipeline.stages.learning.task import LearningTask
from pipeline.stages.learning.training import CURVE, EVALUATION, POLICY, RECORD
from pipeline.store.atomic_files import atomic_path, write_json
from pipeline.task import TASK

if TYPE_CHECKING:
    from enn.imitation.behaviour_cloning import BehaviourCloningSettings
    from enn.imitation.cloned_policy import ClonedPolicy
    from enn.policy import Policy
    from enn.trajectory import Trajectory

PRELOAD = (
    "cathsim",
    "enn.imitation.behaviour_cloning",
    "enn.policy",
    "enn.imitation.dagger",
    "pipeline.recording.record",
)
_FITTING = 0.6  # share of a job's time


@dataclass(frozen=True)
class ImitationJob:
    """A student to fit and to evaluate.

    Attributes:
        folder: of the student.
        task: of the expert's episodes, and of the student's own.
        expert: folder of the expert's training, with its policy and episodes.
        seed: of the fit.
        origin: kept in the logs.
        observations: that the student sees.
        episodes: of the expert to learn from.
        variant: "desk" or "thesis".
        feature_matching: weight.
        epochs: 0: the variant's own.
        disturbed_episodes: further ones with disturbed actions.
        dagger_rounds: 0: none.
        dagger_episodes: a round.
        evaluation_episodes: deterministic, and as many stochastic ones.
    """

    folder: Path
    task: LearningTask
    expert: Path
    seed: int
    origin: Origin
    observations: tuple[str, ...]
    episodes: int
    variant: str
    feature_matching: float
    epochs: int = 0
    disturbed_episodes: int = 0
    dagger_rounds: int = 0
    dagger_episodes: int = 10
    evaluation_episodes: int = 30


def imitate(job: ImitationJob, report: Report) -> dict[str, Any]:
    """Fits a student and evaluates it on held-out seeds; each part only where it lacks.

    Args:
        job: what to do.
        report: takes the progress.

    Returns:
        ``samples``, ``episodes``, ``cpu_s`` and the summaries of both modes.
    """
    from enn.imitation.cloned_policy import ClonedPolicy

    logs = expert_logs(job.expert)
    told = job.folder / RECORD
    if (job.folder / POLICY).is_file() and told.is_file():
        student, outcome = (
            ClonedPolicy.load(job.folder / POLICY, report.device),
            json.loads(told.read_text(encoding="utf-8")),
        )
    else:
        student, outcome = _student(job, read_episodes(logs, job.episodes), report)
    environment = job.task.environment(student.keys)
    share = (1.0 - _FITTING) / len(MODES)
    for index, mode in enumerate(MODES):
        metrics = run_trials(
            environment,
            controllers(student, mode),
            job.folder / EVALUATION / mode,
            seeds=held_out_seeds(job.seed, job.evaluation_episodes),
            mode=mode,
            origin=job.origin,
            report=report.part(_FITTING + index * share, _FITTING + (index + 1) * share, mode),
        )
        outcome[mode] = summary(metrics)
    environment.close()
    return outcome


def _student(job: ImitationJob, episodes: list[Trajectory], report: Report) -> tuple[ClonedPolicy, dict[str, Any]]:
    """Fits the student and keeps it with a record of the fit."""
    from enn.imitation.behaviour_cloning import clone
    from enn.imitation.dagger import DaggerSettings, dagger

    began, worked = time.monotonic(), time.process_time()
    settings, task = job_settings(job), job.task
    expert = load_expert(job.expert, report.device)
    if job.disturbed_episodes:
        episodes = episodes + disturbed(task, expert, settings.network.keys, job.disturbed_episodes, job.seed)
    features = None
    if settings.feature_matching and all(set(expert.keys) <= set(one.observations) for one in episodes):
        features = [expert.features({key: one.observations[key] for key in expert.keys}) for one in episodes]
    parts = job.dagger_rounds + 1
    student, fitted = clone(
        episodes,
        settings,
        expert_features=features,
        seed=job.seed,
        folder=job.folder / "fit",
        device=report.device,
        progress=lambda told: report(
            _FITTING / parts * told.epoch / told.epochs, f"epoch {told.epoch}, loss {told.loss:.3f}"
        ),
    )
    outcome: dict[str, Any] = {"episodes": len(episodes), "samples": sum(map(len, episodes)), "rounds": []}
    if job.dagger_rounds:
        keys = tuple(dict.fromkeys((*student.keys, *expert.keys)))
        student, rounds, everything = dagger(
            task.factory(keys),
            _actor(expert),
            episodes,
            DaggerSettings(rounds=job.dagger_rounds, episodes=job.dagger_episodes, cloning=settings),
            student=student,
            seed=job.seed,
            device=report.device,
            progress=lambda index, told: report(
                _FITTING * (index + told.epoch / told.epochs) / parts, f"DAgger round {index}, epoch {told.epoch}"
            ),
        )
        fitted = rounds[-1].fit
        outcome |= {"episodes": len(everything), "samples": sum(map(len, everything))}
        outcome["rounds"] = [
            {"episodes": one.episodes, "success_pct": 100 * one.success, "disagreement": one.disagreement}
            for one in rounds
        ]
    student.metadata |= {
        "phantom": task.phantom,
        "target": task.target,
        "seed": job.seed,
        "row": job.origin.row,
        TASK: asdict(task.task),
    }
    outcome |= {"training_s": time.monotonic() - began, "cpu_s": time.process_time() - worked, "seed": job.seed}
    with atomic_path(job.folder / CURVE) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        table = csv.DictWriter(stream, ("epoch", "loss", "validation", "cpu_s"))
        table.writeheader()
        table.writerows(fitted.rows)
    student.save(job.folder / POLICY)
    write_json(job.folder / RECORD, outcome)
    return student, outcome


def job_settings(job: ImitationJob) -> BehaviourCloningSettings:
    """The variant's settings with what the job changes."""
    from enn.imitation.behaviour_cloning import cloning_preset

    preset = cloning_preset(job.variant)
    fit = replace(preset.fit, epochs=job.epochs) if job.epochs else preset.fit
    network = replace(preset.network, keys=job.observations)
    return replace(preset, fit=fit, network=network, feature_matching=job.feature_matching)


def disturbed(task: LearningTask, expert: Policy, keys: Sequence[str], count: int, seed: int) -> list[Trajectory]:
    """Episodes of the expert with disturbed actions; what it wanted done is what is learnt.

    Args:
        task: that they run in.
        expert: steers.
        keys: observations that the student sees; those of the expert are kept too.
        count: of episodes.
        seed: of the student.
    """
    from enn.imitation.dagger import Disturbed, record

    seen = tuple(dict.fromkeys((*keys, *expert.keys)))
    environment = task.environment(seen, training=True)
    actor = _actor(expert)
    episodes = [
        record(
            environment,
            Disturbed(actor, np.random.default_rng((seed, index))),
            seed=disturbed_seeds(seed, count)[index],
            keys=seen,
            labels=actor,
            metadata={"file": f"disturbed episode {index}"},
        )
        for index in range(count)
    ]
    environment.close()
    return episodes


def _actor(expert: Policy) -> Any:
    return lambda observation, info: expert.act(observation)
