"""Tests of a rehearsal: logged episodes in the scan and in copies that nothing was trained or chosen in."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.jobs.worker import Report
from pipeline.recording.trials import controllers, retrying, run_trials
from pipeline.seeds import ANATOMY_COPIES, held_out_seeds
from pipeline.stages.rehearsal.copies import COPIES, SCAN, RehearsalJob, copies_environment


def play(job: RehearsalJob, report: Report) -> dict[str, Any]:
    """Logs an episode in each copy of a test, or several on the scan, whose log is not there yet.

    Returns:
        Success of each episode in its first attempt and in any, its tip's depth at the end, m, and the contact forces
        of its steps, N.
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
    logs, success, first, depths = [], [], [], []
    report(0.0, f"0/{len(job.copies)}")
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
        depths += [one.depth for one in metrics]
        logs += [folder / f"{number:03d}.mcap" for number in range(count)]
        report((case + 1) / len(job.copies), f"{sum(success)}/{len(success)}")
    environment.close()
    forces = []
    for log in logs:
        with EpisodeReader(log) as episode:
            arrays = episode.load_arrays(pictures=False)
        forces.append(np.linalg.norm(arrays["resultant_force"][1:], axis=1).tolist())
    ended = {"success": first, "within_attempts": success, "depths": depths}
    return {**ended, "forces": forces, "logs": [str(log) for log in logs]}
