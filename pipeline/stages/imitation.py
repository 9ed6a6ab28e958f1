"""The imitation stage: the expert's episodes learnt from with the image alone, by behaviour cloning and by DAgger.

A student's folder, ``<phantom>/<target>/<row>/seed<k>/``, holds::

    policy.pt  training.csv  training.json
    evaluation/{deterministic,stochastic}/NNN.mcap
    fit/                                          checkpoint, until the student is fitted
"""

from __future__ import annotations

import csv
import functools
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from enn.curves import Curves
from pipeline.anatomies.settings import check_anatomies, settle
from pipeline.jobs.pool import Job, run_jobs
from pipeline.jobs.worker import POLICIES, Report
from pipeline.recording.trials import POLICY, Origin, controllers, log_success
from pipeline.seeds import disturbed_seeds
from pipeline.settings.kinds import require_modalities
from pipeline.stages import Stage, StageContext
from pipeline.stages.job_memory import LEARNT_BATCH, policy_gb
from pipeline.stages.learning.aids import note, of_task
from pipeline.stages.learning.expert_episodes import (
    expert_folder,
    expert_logs,
    load_expert,
    read_episodes,
    require_expert,
)
from pipeline.stages.learning.settings import ImitationSettings
from pipeline.stages.learning.shared_training import CURVE, RECORD
from pipeline.stages.learning.task import LearningTask
from pipeline.stages.learning.training import evaluate
from pipeline.store.atomic_files import atomic_path, read_json, write_json
from pipeline.store.errors import stopping_the_stage
from pipeline.tables import Results
from pipeline.task import TASK, require_known_task

if TYPE_CHECKING:
    from enn.imitation.behaviour_cloning import BehaviourCloningSettings
    from enn.imitation.cloned_policy import ClonedPolicy
    from enn.imitation.dagger import DaggerSettings


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
    """Fits a student and evaluates it on held-out seeds, each where it lacks; sizes, ``rounds``, times, summaries."""
    from enn.imitation.cloned_policy import ClonedPolicy

    record = job.folder / RECORD
    if (job.folder / POLICY).is_file() and record.is_file():
        student = ClonedPolicy.load(job.folder / POLICY, report.device)
        outcome = read_json(record)
    else:
        student, outcome = _student(job, report)
    environment = job.task.environment(student.keys)
    outcome |= evaluate(environment, functools.partial(controllers, student), job, report.part(_FITTING, 1.0))
    environment.close()
    return outcome


def _student(job: ImitationJob, report: Report) -> tuple[ClonedPolicy, dict[str, Any]]:
    """Fits the student and keeps it with a record of the fit."""
    from enn.fitting import FitError
    from enn.imitation.distillation import distil

    began, worked, seed = time.monotonic(), time.process_time(), job.origin.training_seed
    with stopping_the_stage(FitError):
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


CLONED, DISTURBED, DAGGER = "image_w_enn", "image_w_enn_disturbed", "dagger"


def check_imitation(settings: ImitationSettings) -> None:
    """Refuses unknown phantoms and modality sets."""
    check_anatomies(settings)
    require_modalities(settings.expert)
    require_known_task(settings.task)


def run_imitation(settings: ImitationSettings, context: StageContext) -> Results:
    jobs = plan(settings, context)
    outcomes = run_jobs(
        context.folder, jobs, workers=settings.workers, label="students", preload=POLICIES, device=settings.device
    )
    tables = {
        "bc_architecture": architecture(),
        "bc_hyperparameters": hyperparameters(settings),
        "imitation_episodes": by_episodes(jobs, outcomes),
        "dagger_rounds": by_round(jobs, outcomes),
    }
    log_success(outcomes)
    return Results(
        {name: table for name, table in tables.items() if table},
        notes={"imitation": note((job.given for job in jobs), of_imitation)},
    )


def plan(settings: ImitationSettings, context: StageContext) -> list[Job]:
    """The students: a task and number of episodes each, then those with disturbed episodes and by DAgger."""
    from enn.imitation.behaviour_cloning import cloning_settings
    from enn.imitation.dagger import DaggerSettings

    jobs = []
    cloning = cloning_settings(
        settings.variant, tuple(settings.observations), settings.feature_matching, settings.epochs
    )
    gpu_gb = policy_gb(settings.task.image_size_px, len(settings.observations), LEARNT_BATCH)
    for phantom in settings.phantoms:
        for target in settings.targets:
            task = LearningTask(phantom, target, settings.task, settings.anatomy_file)
            expert = expert_folder(context.inputs["enn"], task.name, settings.expert)
            logs = expert_logs(expert)
            read_episodes(logs, 1)  # an empty folder is refused before any work
            require_expert(settings.name, task, expert)
            most = min(settings.episodes[-1], len(logs))
            counts = sorted({min(count, most) for count in settings.episodes})
            rows: list[tuple[str, int, int, DaggerSettings | None]] = [
                (CLONED if count == most else f"{CLONED}_{count}", count, 0, None) for count in counts
            ]
            if settings.disturbed_episodes:
                rows.append((DISTURBED, most, settings.disturbed_episodes, None))
            if settings.dagger_rounds:
                rows.append((DAGGER, counts[0], 0, DaggerSettings(settings.dagger_rounds, settings.dagger_episodes)))
            for row, count, disturbed, rounds in rows:
                imitation_job = ImitationJob(
                    folder=context.path / task.name / row / f"seed{context.seed}",
                    origin=Origin(settings.name, row, context.seed, settings.variant),
                    settings=cloning,
                    task=task,
                    expert=expert,
                    episodes=count,
                    disturbed_episodes=disturbed,
                    rounds=rounds,
                    evaluation_episodes=settings.evaluation_episodes,
                    drawn_episodes=settings.drawn_episodes,
                )
                jobs.append(Job(f"{task.name}/{row}", imitate, imitation_job, gpu_gb=gpu_gb))
    return jobs


def architecture() -> dict[str, dict[str, Any]]:
    """The layers of the thesis's network as it is built here, in the thesis's table."""
    from enn.imitation.cloned_policy import CloningNetwork, CloningNetworkSettings
    from enn.networks.features import LAYER_COLUMNS, layer_table

    layers = CloningNetwork(CloningNetworkSettings(variant="thesis")).layers()
    return {
        row: dict(zip(LAYER_COLUMNS, cells, strict=True)) for row, cells in layer_table(layers, (1, 80, 80)).items()
    }


def hyperparameters(settings: ImitationSettings) -> dict[str, dict[str, Any]]:
    """What the students were fitted with."""
    from enn.imitation.behaviour_cloning import cloning_preset

    used = cloning_preset(settings.variant)
    values = {
        "batch_size": used.fit.batch_size,
        "optimizer": "Adam" if used.fit.weight_decay == 0 else "AdamW",
        "learning_rate": used.fit.learning_rate,
        "ent_coef": used.entropy,
        "epochs": settings.epochs or used.fit.epochs,
        "feature_matching": settings.feature_matching,
    }
    return {name: {"value": value} for name, value in values.items()}


def by_episodes(jobs: Sequence[Job], outcomes: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Row ``phantom/target/episodes`` to success in % of the deterministic episodes."""
    table = {}
    for job in jobs:
        if job.given.disturbed_episodes or job.given.rounds:
            continue
        task, outcome = job.key.rpartition("/")[0], outcomes[job.key]
        row = f"{task}/{outcome['episodes']} episodes"
        table[row] = {"success_pct": outcome["deterministic"]["success_pct"], "n": outcome["deterministic"]["n"]}
    return table


def by_round(jobs: Sequence[Job], outcomes: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Row ``phantom/target/round k`` to success of the student's roll-outs and distance to the expert's actions."""
    table = {}
    for job in jobs:
        for index, done in enumerate(outcomes[job.key]["rounds"]):
            table[f"{job.key.rpartition('/')[0]}/round {index + 1}"] = dict(done)
    return table


def of_imitation(job: ImitationJob) -> list[str]:
    """What a student was fitted with."""
    aids = [
        f"{job.origin.variant} network, from {job.episodes} episodes of the expert, which had the aids of its own "
        "table",
        *of_task(job.task.task, job.settings.network.keys),
    ]
    if job.settings.feature_matching:
        aids.append(f"the expert's features matched with weight {job.settings.feature_matching:g}, which is ours")
    if job.disturbed_episodes:
        aids.append(f"{job.disturbed_episodes} more episodes with disturbed actions")
    if job.rounds is not None:
        aids.append(f"{job.rounds.rounds} rounds of {job.rounds.episodes} own episodes with the expert's advice")
    return aids


STAGE = Stage(
    settings=ImitationSettings, run=run_imitation, reads=("enn",), prepare=settle, check=check_imitation, repeated=True
)
