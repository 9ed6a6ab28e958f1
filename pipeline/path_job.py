"""The path-following job: the thesis's attempt to learn the actions along the planned path, fitted and evaluated."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.episodes import EpisodeReader
from pipeline.errors import StageError
from pipeline.job_worker import Report
from pipeline.learning_task import LearningTask, held_out_seeds
from pipeline.training_job import EVALUATION
from pipeline.trials import MODES, Origin, run_trials, summary

if TYPE_CHECKING:
    from enn.trajectory import Trajectory

FOLLOWER = "follower.pt"
ROW = "path_follower"
_FIT_SHARE = 0.1


@dataclass(frozen=True)
class PathJob:
    """A path follower to fit and to evaluate.

    Attributes:
        folder: of the fit.
        task: that it is for.
        seed: of the fit.
        origin: kept in the logs.
        demonstrations: logs of the sampling expert's episodes of the task.
        evaluation_episodes: all deterministic: the network gives one action.
    """

    folder: Path
    task: LearningTask
    seed: int
    origin: Origin
    demonstrations: tuple[Path, ...]
    evaluation_episodes: int


def follow(job: PathJob, report: Report) -> dict[str, Any]:
    """Fits a path follower to the expert's episodes and evaluates it on held-out seeds.

    Args:
        job: which.
        report: takes the progress.

    Returns:
        ``episodes`` that it was fitted to, and the ``deterministic`` summary.

    Raises:
        StageError: there are no episodes to fit it to.
    """
    from cathsim import load_phantom
    from cathsim.planning.path import plan_path
    from enn.path_following import PathFollower, fit_path_follower

    if not job.demonstrations:
        raise StageError(
            f"the path follower of {job.task.name} has no expert episodes: run stage expert with this task, or set "
            "stage.path_follower=false"
        )
    phantom = load_phantom(job.task.phantom)
    path = plan_path(phantom.grid, phantom.entry("descending").position, phantom.target(job.task.target).position)
    file = job.folder / FOLLOWER
    if not file.is_file():
        report(0.0, "fit")
        episodes = [steps_of(log) for log in job.demonstrations]
        follower, _ = fit_path_follower(episodes, [path.points] * len(episodes), seed=job.seed)
        follower.save(file)
    follower = PathFollower.load(file)
    environment = job.task.environment("tip")
    metrics = run_trials(
        environment,
        lambda seed: follower.controller(path.points),
        job.folder / EVALUATION / MODES[0],
        seeds=held_out_seeds(job.seed, job.evaluation_episodes),
        mode=MODES[0],
        origin=job.origin,
        report=report.part(_FIT_SHARE, 1.0, "evaluation"),
    )
    environment.close()
    return {"episodes": len(job.demonstrations), MODES[0]: summary(metrics)}


def steps_of(log: Path) -> Trajectory:
    """Tips and actions of a logged episode, without any observation."""
    from enn.trajectory import Trajectory

    with EpisodeReader(log) as reader:
        arrays = reader.load_arrays(pictures=False)
    return Trajectory(
        observations={},
        actions=arrays["action"][1:].astype(np.float32),
        rewards=arrays["reward"][1:],
        terminated=bool(arrays["terminated"][-1]),
        forces=arrays["resultant_force_norm"][1:],
        tips=arrays["tip"],
        metadata={"file": str(log)},
    )
