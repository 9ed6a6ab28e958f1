"""Training of a rehearsal: from the policy that it starts from, and once more from its own while it seldom arrives."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.jobs.worker import Report, map_simulations
from pipeline.recording.trials import POLICY
from pipeline.seeds import validation_copies
from pipeline.stages.learning.training import words
from pipeline.stages.rehearsal.copies import RehearsalJob, copies_environment, held_steps, threads_of, training_settings
from pipeline.stages.rehearsal.demonstrations import first_turn, read_demonstrations
from pipeline.stages.rehearsal.settings import SAC
from pipeline.store.atomic_files import atomic_path, write_arrays
from pipeline.store.costs import processor_s
from pipeline.store.errors import stopping_the_stage
from pipeline.task import TASK

if TYPE_CHECKING:
    from enn.policy import Policy
    from enn.reinforcement.evaluation import EvaluationResult
    from enn.reinforcement.training import Progress, TrainingResult, TrainingSettings

STARTS = "starts.npz"
FURTHER = "further"  # folder, in the training's, of each that goes on from it: further1, further2, ...
_LAID = 0.1  # of the training's job


def train(job: RehearsalJob, report: Report) -> dict[str, Any]:
    """Lays starts and trains, each only where it lacks, and further while it seldom arrives: times, decisions."""
    from enn.policy import Policy
    from enn.reinforcement.checkpoint import CheckpointError
    from enn.reinforcement.rehearsal import first_evaluation, rehearse
    from enn.reinforcement.rehearsal_rules import in_share

    map_simulations()
    settings, seed = job.settings, job.origin.training_seed
    rules, outcomes = job.rules, first_turn(job)
    begun = processor_s()
    copies = job.training_cases
    starts, shown = _laid_starts(job, copies, report), read_demonstrations(job.folder)
    validated = (0, *validation_copies(settings.validation_copies))
    results: list[TrainingResult] = []
    with stopping_the_stage(CheckpointError, ValueError):
        policy = None if job.start is None else Policy.load(job.start, report.device)
        environment = partial(copies_environment, job, observe_every=held_steps(job))
        may_be_fewer = settings.share_of_decisions < 1 and settings.algorithm == SAC
        always = in_share(outcomes, job.tried, 1.0)
        evaluations = rules.fewer_evaluations if may_be_fewer and always else None
        usual = training_settings(job, report.device, evaluations=evaluations)
        shorter = training_settings(job, report.device, fewer=True)
        played: list[EvaluationResult] = []

        def elsewhere() -> list[bool]:
            assert policy is not None
            report(_LAID, "whether fewer decisions are enough")
            played.append(first_evaluation(policy, partial(environment, validated), usual, seed=seed))
            return [one.success for one in played[0].outcomes]

        def tell(progress: Progress) -> None:
            before = sum(result.timings["decisions"] for result in results)
            share = (before + progress.decisions) / (before + progress.total)
            report(_LAID + (1 - _LAID) * share, words(progress))

        def trained(start: Policy | None, training: TrainingSettings, folder: str, **given: Any) -> TrainingResult:
            return rehearse(
                partial(environment, copies, training=True),
                make_validation_env=partial(environment, validated),
                policy=start,
                settings=training,
                starts=starts,
                demonstrations=shown,
                folder=job.own_folder / folder,
                seed=seed,
                metadata={**job.origin.configuration("training"), TASK: asdict(job.task)},
                progress=tell,
                **given,
            )

        fewer = may_be_fewer and rules.mostly_arrives(outcomes, job.tried, elsewhere)
        first = played[0] if played else None
        results.append(trained(policy, shorter if fewer else usual, "", first_result=first))
        for number in range(1, settings.further_trainings + 1):
            if settings.algorithm != SAC or not rules.sometimes_arrives(results[-1]):
                break
            results.append(trained(results[-1].policy, shorter, f"{FURTHER}{number}"))
            with atomic_path(job.own_folder / POLICY) as path:
                shutil.copyfile(job.own_folder / f"{FURTHER}{number}" / POLICY, path)
    return {
        "cpu_s": round(processor_s() - begun, 1),
        "training_wall_s": round(sum(result.timings["wall_s"] for result in results), 1),
        "decisions": int(sum(result.timings["decisions"] for result in results)),
        "further_trainings": len(results) - 1,
    }


def _laid_starts(job: RehearsalJob, copies: Sequence[int], report: Report) -> list[np.ndarray]:
    from enn.reinforcement.workers import Workers

    path = job.folder / STARTS
    if not path.is_file():
        threads = min(threads_of(job.settings), len(copies))
        environments = [copies_environment(job, copies, training=True) for _ in range(threads)]
        workers = Workers(threads)
        arrays: dict[str, np.ndarray] = {}
        for first in range(0, len(copies), threads):
            report(_LAID * first / len(copies), f"starts in copy {copies[first]}")
            cases = range(first, min(first + threads, len(copies)))
            laid = workers.each(
                lambda case: environments[case % threads].laid_starts(case, job.origin.training_seed), cases
            )
            arrays |= dict(zip(map(str, cases), laid, strict=True))
        workers.close()
        for environment in environments:
            environment.close()
        write_arrays(path, arrays)
    with np.load(path) as kept:
        return [states for name in kept.files if len(states := kept[name])]
