"""The baselines stage: PPO and SAC on joints, one image or three, and a policy that follows the planned path."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from pipeline.anatomies.settings import settle
from pipeline.evaluations.tables import log_summary
from pipeline.jobs.pool import Job
from pipeline.recording.trials import Origin
from pipeline.stages import Stage, StageContext
from pipeline.stages.gpu_memory import policy_gb
from pipeline.stages.learning.aids import training_note
from pipeline.stages.learning.expert_episodes import require_demonstrations
from pipeline.stages.learning.hyperparameters import with_hyperparameters
from pipeline.stages.learning.path_following import ROW, PathJob, follow
from pipeline.stages.learning.plan import (
    THESIS,
    check_learning,
    demonstrations,
    planned_training,
    run_trainings,
    task_of,
    training_seeds,
)
from pipeline.stages.learning.settings import BaselinesSettings
from pipeline.stages.learning.training import PolicyTrainingJob
from pipeline.tables import Results
from pipeline.task import FEEDER, observed

if TYPE_CHECKING:
    from enn.reinforcement import TrainingSettings

SECONDS_AN_EPISODE = 0.3  # of the path follower's; only for the estimate of the end


def run_baselines(settings: BaselinesSettings, context: StageContext) -> Results:
    """Trains and evaluates every row of the table."""
    followers = path_followers(settings, context) if settings.path_follower else []
    trainings = plan(settings, context)
    run_trainings(trainings, settings, context, beside=followers)
    log_summary(context.path)
    tables = {"task": {"episode_limit_rl": {"value": settings.task.max_steps}}}
    return Results(tables, notes={"cathsim_results": training_note(trainings)})


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


def training_settings(settings: BaselinesSettings, algorithm: str, observation: str) -> TrainingSettings:
    """Hyper-parameters of a row of the table: "ppo" or "sac" on "internal", "image" or "sequential"."""
    from enn.reinforcement import DESK_PPO, DESK_SAC
    from enn.reinforcement.training.settings import thesis_baseline

    ppo = algorithm == "ppo"
    preset: TrainingSettings = DESK_PPO if ppo else DESK_SAC
    if settings.variant == THESIS:
        preset = thesis_baseline(algorithm, observation)
    decisions = settings.ppo_decisions if ppo else settings.decisions
    sized = preset.sized(decisions, settings.evaluation_episodes, tensorboard=True)
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
                        weight=settings.evaluation_episodes * SECONDS_AN_EPISODE,
                        gpu_gb=policy_gb(settings.task.image_size_px, 0),
                    )
                )
    return jobs


STAGE = Stage(
    settings=BaselinesSettings,
    run=run_baselines,
    reads=("expert",),
    prepare=settle,
    check=check_learning,
)
