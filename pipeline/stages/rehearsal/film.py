"""The film of a rehearsed policy in the scan itself: its first episode of the tests that arrived."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from pipeline.jobs.worker import Report
from pipeline.recording.trials import controllers, recorded, retrying
from pipeline.seeds import held_out_seeds
from pipeline.stages.rehearsal.copies import SCAN, RehearsalJob, copies_environment
from pipeline.store.atomic_files import atomic_path

_USUAL_STEPS = 300  # of an episode, whose film has every second step; that of one twice as long every fourth


def film_file(tested: str | None) -> str:
    """Where the film of a row of the table lies, in the stage's folder."""
    return f"{tested}.gif"


def film_scan(job: RehearsalJob, report: Report) -> dict[str, Any]:
    """Repeats an episode in the scan and films it: the first one that arrived, the first one where none did.

    Returns:
        Its number, whether it arrived, and its steps.
    """
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
    shown = environment.current
    controller = retrying(controllers(Policy.load(job.policy), settings.mode), steps, settings.attempts)(seeds[number])
    file = settings.anatomy_file
    film = Film(STRIDE * math.ceil(task.max_steps / _USUAL_STEPS), None if file is None else file.room())
    try:
        observation, info = shown.reset(seed=seeds[number])
        film.add(shown)
        arrived = ended = False
        while not ended:
            observation, _, arrived, truncated, info = shown.step(controller(observation, info))
            film.add(shown)
            ended = arrived or truncated
            report(shown.steps / task.max_steps, f"step {shown.steps}")
        with atomic_path(job.folder / film_file(job.tested)) as temporary:
            film.write(temporary)
    finally:
        film.close()
        environment.close()
    return {"episode": number, "arrived": bool(arrived), "steps": shown.steps}
