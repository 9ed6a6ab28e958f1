"""Jobs of the stage rehearsal: the training in copies of a scan, and logged episodes in other copies.

The stage's folder draws as::

    starts.npz                                     wires laid along the way in the training's copies
    demonstrations/<policy>_<copy>_<round>.npz     of the training, where other policies were asked, too
    seed<k>/{policy.pt, training.csv, training.json}
    {before,after}/<scan or copies>/<copy>/NNN.mcap
    after.gif                                      an episode in the scan
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.jobs.freed_memory import map_simulations
from pipeline.jobs.job import OPTIMISER
from pipeline.jobs.worker import Report
from pipeline.recording.trials import controllers, retrying, run_trials
from pipeline.seeds import ANATOMY_COPIES, held_out_seeds, validation_copies
from pipeline.stages.rehearsal.copies import COPIES, SCAN, RehearsalJob, copies_environment
from pipeline.stages.rehearsal.demonstrations import mostly_arrives, read_demonstrations
from pipeline.stages.rehearsal.hyperparameters import held_steps, threads_of, training_settings
from pipeline.stages.rehearsal.settings import SAC
from pipeline.store.atomic_files import write_arrays
from pipeline.store.errors import stopping_the_stage
from pipeline.task import TASK

if TYPE_CHECKING:
    from enn.reinforcement.evaluation import EvaluationResult

STARTS = "starts.npz"
PRELOAD = ("cathsim.rehearsal.environment", "enn.reinforcement.rehearsal", "pipeline.recording.record", OPTIMISER)
_LAID = 0.1  # of the training's job


def train(job: RehearsalJob, report: Report) -> dict[str, Any]:
    """Lays starts and trains, each only where it lacks.

    Returns:
        Time and decisions.
    """
    from enn.policy import Policy
    from enn.reinforcement.checkpoint import CheckpointError
    from enn.reinforcement.rehearsal import first_evaluation, rehearse

    map_simulations()
    settings, seed = job.settings, job.origin.training_seed
    begun = time.process_time()
    copies = job.training_cases
    starts, shown = _laid_starts(job, copies, report), read_demonstrations(job.folder)
    validated = (0, *validation_copies(settings.validation_copies))
    with stopping_the_stage(CheckpointError, ValueError):
        policy = None if job.start is None else Policy.load(job.start, report.device)
        environment = partial(copies_environment, job, observe_every=held_steps(job))

        usual = training_settings(job, report.device)
        played: list[EvaluationResult] = []

        def elsewhere() -> list[bool]:
            assert policy is not None
            report(_LAID, "whether fewer decisions are enough")
            played.append(first_evaluation(policy, partial(environment, validated), usual, seed=seed))
            return [one.success for one in played[0].outcomes]

        may_be_fewer = settings.share_of_decisions < 1 and settings.algorithm == SAC
        fewer = may_be_fewer and mostly_arrives(job, elsewhere)
        training = training_settings(job, report.device, fewer=True) if fewer else usual
        result = rehearse(
            partial(environment, copies, training=True),
            make_validation_env=partial(environment, validated),
            policy=policy,
            settings=training,
            starts=starts,
            demonstrations=shown,
            folder=job.own_folder,
            seed=seed,
            first_result=played[0] if played else None,
            metadata={**job.origin.configuration("training"), TASK: asdict(job.task)},
            progress=lambda p: report(
                _LAID + (1 - _LAID) * p.decisions / p.total, f"success {100 * (p.success or 0):.0f} %"
            ),
        )
    return {
        "cpu_s": round(time.process_time() - begun, 1),
        "training_wall_s": round(result.timings["wall_s"], 1),
        "decisions": int(result.timings["decisions"]),
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


def play(job: RehearsalJob, report: Report) -> dict[str, Any]:
    """Logs an episode in each copy of a test, or several on the scan, whose log is not there yet.

    Returns:
        Success of each episode in its first attempt and in any, and for each the contact forces of its steps, N.
    """
    from enn.policy import Policy
    from enn.retrying import steps_of_attempts
    from pipeline.episodes import EpisodeReader

    assert job.policy is not None
    attempts, steps = job.settings.attempts, job.task.max_steps
    task = replace(job.task, max_steps=steps_of_attempts(steps, attempts))
    environment = copies_environment(replace(job, task=task), job.copies)
    policy = Policy.load(job.policy)
    kind = SCAN if job.copies == (0,) else COPIES
    logs, success, first = [], [], []
    for case, copy in enumerate(job.copies):
        environment.reset(seed=0, options={"case": case})
        folder = job.folder / str(job.tested) / kind / str(copy)
        count = job.settings.scan_episodes if copy == 0 else 1
        begun = 0 if copy == 0 else copy - ANATOMY_COPIES["test"].first
        seeds = held_out_seeds(job.origin.training_seed, begun + count)[begun:]
        metrics = run_trials(
            environment.current,
            retrying(controllers(policy, job.settings.mode), steps, attempts),
            folder,
            seeds=seeds,
            mode=job.settings.mode,
            origin=replace(job.origin, row=str(job.tested), further={"test_set": kind, "copy": copy}),
        )
        success += [bool(one.success) for one in metrics]
        first += [bool(one.success and one.steps <= steps) for one in metrics]
        logs += [folder / f"{number:03d}.mcap" for number in range(count)]
        report((case + 1) / len(job.copies), f"{sum(success)}/{len(success)}")
    environment.close()
    forces = []
    for log in logs:
        with EpisodeReader(log) as episode:
            arrays = episode.load_arrays(pictures=False)
        forces.append(np.linalg.norm(arrays["resultant_force"][1:], axis=1).tolist())
    return {"success": first, "within_attempts": success, "forces": forces, "logs": [str(log) for log in logs]}
