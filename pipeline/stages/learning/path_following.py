"""The path-following job: the thesis's attempt to learn the actions along the planned path, fitted and evaluated."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.episodes import EpisodeReader
from pipeline.episodes.errors import EpisodeReadError
from pipeline.jobs.worker import Report
from pipeline.recording.trials import MODES, Origin, run_trials, summary
from pipeline.seeds import held_out_seeds
from pipeline.stages.learning.task import LearningTask
from pipeline.stages.learning.training import EVALUATION
from pipeline.store.errors import StageError

if TYPE_CHECKING:
    from enn.trajectory import Trajectory

FOLLOWER = "follower.pt"
ROW = "path_follower"
_FIT_SHARE = 0.1

_LOGGER = logging.getLogger(__name__)


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
        The ``deterministic`` summary.

    Raises:
        StageError: there are no episodes to fit it to.
    """
    from cathsim import load_phantom
    from cathsim.planning.path import plan_path
    from enn.imitation.path_following import PathFollower, fit_path_follower

    file = job.folder / FOLLOWER
    episodes = [] if file.is_file() else demonstrated(job.demonstrations)
    if not (episodes or file.is_file()):
        raise StageError(
            f"the path follower of {job.task.name} has no expert episodes: run stage expert with this task, or set "
            "stage.path_follower=false"
        )
    phantom = load_phantom(job.task.phantom)
    path = plan_path(phantom.grid, phantom.entry("descending").position, phantom.target(job.task.target).position)
    if episodes:
        report(0.0, "fit")
        follower, _ = fit_path_follower(episodes, [path.points] * len(episodes), seed=job.seed, device=report.device)
        follower.save(file)
    follower = PathFollower.load(file, report.device)
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
    return {MODES[0]: summary(metrics)}


def demonstrated(logs: Sequence[Path]) -> list[Trajectory]:
    """Tips and actions of logged episodes; a damaged one is left out with a warning.

    Args:
        logs: of the sampling expert's episodes.
    """
    episodes = []
    for log in logs:
        try:
            episodes.append(steps_of(log))
        except (EpisodeReadError, ValueError) as error:
            _LOGGER.warning("%s is left out: %s", log, error)
    return episodes


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
