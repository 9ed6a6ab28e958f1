"""The baselines stage: PPO and SAC on joints, one image or three, and a policy that follows the planned path."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from enn.curves import Curves, chosen_logger
from pipeline.anatomies.settings import settle
from pipeline.jobs.pool import Job
from pipeline.jobs.worker import Report
from pipeline.recording.trials import Origin
from pipeline.stages import Stage, StageContext
from pipeline.stages.job_memory import policy_gb
from pipeline.stages.learning.aids import note, of_training
from pipeline.stages.learning.expert_episodes import read_episode, readable, require_demonstrations
from pipeline.stages.learning.settings import BaselinesSettings, with_hyperparameters
from pipeline.stages.learning.task import LearningTask
from pipeline.stages.learning.training import (
    THESIS,
    PolicyTrainingJob,
    check_learning,
    demonstrations,
    evaluate,
    planned_training,
    run_trainings,
    task_of,
    training_seeds,
)
from pipeline.store.errors import StageError
from pipeline.tables import Results
from pipeline.task import FEEDER, observed

if TYPE_CHECKING:
    from enn.reinforcement import TrainingSettings


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
    evaluation_episodes: int
    drawn_episodes: int = 0  # none: the network gives one action


def follow(job: PathJob, report: Report) -> dict[str, Any]:
    """Fits a path follower to the expert's episodes; gives the ``deterministic`` summary on held-out seeds."""
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
        environment, lambda mode: lambda seed: follower.controller(path.points), job, report.part(_FIT_SHARE, 1.0)
    )
    environment.close()
    return outcome


def run_baselines(settings: BaselinesSettings, context: StageContext) -> Results:
    followers = path_followers(settings, context) if settings.path_follower else []
    trainings = plan(settings, context)
    run_trainings(trainings, settings, context, beside=followers)
    tables = {"task": {"episode_limit_rl": {"value": settings.task.max_steps}}}
    return Results(tables, notes={"cathsim_results": note(trainings, of_training)})


def plan(settings: BaselinesSettings, context: StageContext) -> list[PolicyTrainingJob]:
    """The trainings of the table: each algorithm with each observation on each task."""
    return [
        planned_training(
            settings,
            context,
            task_of(settings, phantom, target, algorithm=algorithm),
            f"{algorithm}_{observation}",
            seed,
            observed(settings.task, (observation,)),
            training_settings(settings, algorithm, observation),
        )
        for seed in training_seeds(context.seed, settings.seeds, settings.seeds)
        for observation in settings.observations
        for algorithm in settings.algorithms
        for phantom in settings.phantoms
        for target in settings.targets
    ]


def check_baselines(settings: BaselinesSettings) -> None:
    """Refuses unknown phantoms, targets and wires, and hyper-parameters that one of the algorithms has not."""
    check_learning(settings)
    for algorithm in settings.algorithms if settings.training else ():
        for observation in settings.observations:
            training_settings(settings, algorithm, observation)


def training_settings(settings: BaselinesSettings, algorithm: str, observation: str) -> TrainingSettings:
    """Hyper-parameters of a row of the table: "ppo" or "sac" on "internal", "image" or "sequential"."""
    from enn.reinforcement import DESK_PPO, DESK_SAC
    from enn.reinforcement.training.settings import thesis_baseline

    ppo = algorithm == "ppo"
    preset: TrainingSettings = DESK_PPO if ppo else DESK_SAC
    if settings.variant == THESIS:
        preset = thesis_baseline(algorithm, observation)
    decisions = settings.ppo_decisions if ppo else settings.decisions
    sized = preset.sized(decisions, settings.evaluation_episodes, logger=chosen_logger())
    return with_hyperparameters(sized, settings.training)


def path_followers(settings: BaselinesSettings, context: StageContext) -> list[Job]:
    """The jobs of the path follower, one a task and seed; it steers the feeders."""
    jobs = []
    for seed in training_seeds(context.seed, settings.seeds, settings.seeds):
        for phantom in settings.phantoms:
            for target in settings.targets:
                task = task_of(settings, phantom, target)
                task = replace(task, task=replace(task.task, actions=FEEDER))
                logs = demonstrations(task, context)
                require_demonstrations(settings.name, task, logs)
                name = f"{task.name}/{ROW}/seed{seed}"
                origin = Origin(settings.name, ROW, seed, settings.variant, {"force_weight": 0.0})
                jobs.append(
                    Job(
                        name,
                        follow,
                        PathJob(context.path / name, origin, task, logs, settings.evaluation_episodes),
                        gpu_gb=policy_gb(settings.task.image_size_px, 0),
                    )
                )
    return jobs


STAGE = Stage(settings=BaselinesSettings, run=run_baselines, reads=("expert",), prepare=settle, check=check_baselines)
