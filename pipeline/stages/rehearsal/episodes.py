"""Tests of a rehearsal: logged episodes in the scan and in copies that it was not trained in, and a film of one."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.jobs.worker import Report
from pipeline.recording.trials import controllers, recorded, retrying, run_trials
from pipeline.seeds import ANATOMY_COPIES, held_out_seeds
from pipeline.stages.rehearsal.copies import COPIES, SCAN, RehearsalJob, copies_environment
from pipeline.store.atomic_files import atomic_path


def play(job: RehearsalJob, report: Report) -> dict[str, Any]:
    """Logs a test's missing episodes: success in the first attempt and any, depths in m, forces of its steps in N."""
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


_USUAL_STEPS = 300  # of an episode, whose film has every second step; that of one twice as long every fourth


def film_scan(job: RehearsalJob, report: Report) -> dict[str, Any]:
    """Repeats and films the first episode in the scan that arrived, or the first: number, whether it arrived, steps."""
    from cathsim.viewing.film import STRIDE, Film
    from enn.policy import Policy
    from enn.retrying import steps_of_attempts

    assert job.policy is not None
    settings, steps = job.settings, job.task.max_steps
    seeds = held_out_seeds(job.origin.training_seed, settings.scan_episodes)
    logs = job.folder / str(job.tested) / SCAN / "0"
    known = [recorded(logs / f"{number:03d}.mcap", seed) for number, seed in enumerate(seeds)]
    number = next((place for place, one in enumerate(known) if one is not None and one.success), 0)
    task = replace(job.task, max_steps=steps_of_attempts(steps, settings.attempts))
    environment = copies_environment(replace(job, task=task), (0,))
    environment.reset(seed=0, options={"case": 0})
    scan = environment.current
    controller = retrying(controllers(Policy.load(job.policy), settings.mode), steps, settings.attempts)(seeds[number])
    file = settings.anatomy_file
    film = Film(STRIDE * math.ceil(task.max_steps / _USUAL_STEPS), None if file is None else file.background())
    try:
        observation, info = scan.reset(seed=seeds[number])
        film.add(scan)
        arrived = ended = False
        while not ended:
            observation, _, arrived, truncated, info = scan.step(controller(observation, info))
            film.add(scan)
            ended = arrived or truncated
            report(scan.steps / task.max_steps, f"step {scan.steps}")
        with atomic_path(job.folder / f"{job.tested}.gif") as temporary:
            film.write(temporary)
    finally:
        film.close()
        environment.close()
    return {"episode": number, "arrived": bool(arrived), "steps": scan.steps}
