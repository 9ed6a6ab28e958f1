"""The path-following job: the thesis's attempt to learn the actions along the planned path, fitted and evaluated."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from pipeline.jobs.worker import Report
from pipeline.recording.curves import Curves
from pipeline.recording.trials import MODES, Origin
from pipeline.stages.learning.evaluation import evaluate
from pipeline.stages.learning.expert_episodes import read_episode, readable
from pipeline.stages.learning.task import LearningTask
from pipeline.store.errors import StageError

FOLLOWER = "follower.pt"
ROW = "path_follower"
_FIT_SHARE = 0.1


@dataclass(frozen=True)
class PathJob:
    """A path follower to fit and to evaluate."""

    folder: Path
    origin: Origin  # row, seed of the fit and variant; kept in the logs
    task: LearningTask
    demonstrations: tuple[Path, ...]  # logs of the sampling expert's episodes of the task
    evaluation_episodes: int  # all deterministic: the network gives one action


def follow(job: PathJob, report: Report) -> dict[str, Any]:
    """Fits a path follower to the expert's episodes and evaluates it on held-out seeds.

    Returns:
        The ``deterministic`` summary.

    Raises:
        StageError: there are no episodes to fit it to.
    """
    from cathsim.planning.path import plan_path
    from enn.imitation.path_following import PathFollower, fit_path_follower

    file, read = job.folder / FOLLOWER, partial(read_episode, pictures=False)
    episodes = [] if file.is_file() else list(readable(job.demonstrations, read))
    if not (episodes or file.is_file()):
        raise StageError(
            f"the path follower of {job.task.name} has no expert episodes: run stage expert with this task, or set "
            "stage.path_follower=false"
        )
    phantom = job.task.load_phantom()
    entry = phantom.entry(job.task.task.entry)
    path = plan_path(phantom.grid, entry.position, phantom.target(job.task.target).position)
    if episodes:
        report(0.0, "fit")
        paths = [path.points] * len(episodes)
        with Curves(job.folder) as curves:
            follower, _ = fit_path_follower(
                episodes, paths, seed=job.origin.training_seed, device=report.device,
                progress=lambda now: curves.add(now.epoch, loss=now.loss, validation=now.validation),
            )  # fmt: skip
        follower.save(file)
    follower = PathFollower.load(file, report.device)
    environment = job.task.environment("tip")
    outcome = evaluate(
        environment,
        lambda mode: lambda seed: follower.controller(path.points),
        job.folder,
        job.origin,
        {MODES[0]: job.evaluation_episodes},
        report.part(_FIT_SHARE, 1.0),
    )
    environment.close()
    return outcome
