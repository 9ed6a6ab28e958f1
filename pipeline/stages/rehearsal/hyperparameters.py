"""Hyper-parameters of a rehearsal's training, from the stage's settings."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from pipeline.jobs.engines.local import available_workers
from pipeline.stages.learning.hyperparameters import with_hyperparameters
from pipeline.stages.rehearsal.copies import RehearsalJob
from pipeline.stages.rehearsal.settings import SAC, RehearsalSettings
from pipeline.stages.unseen.task import ROADMAP_KEYS

if TYPE_CHECKING:
    from enn.reinforcement.training import TrainingSettings

EVALUATIONS = 3  # in a training, beside that of the policy that it starts from
ENOUGH = 2  # of them, where that policy always arrives
MOST_THREADS = 4  # of a training, unless the settings say; more gain nothing (docs/results/gpu.md)


def threads_of(settings: RehearsalSettings) -> int:
    """Threads that step the environments: as many as there are cores, within reason."""
    return settings.threads or min(available_workers(), MOST_THREADS)


def training_settings(
    job: RehearsalJob, device: str, *, fewer: bool = False, evaluations: int = EVALUATIONS
) -> TrainingSettings:
    """Settings of the training, but for what the policy that it starts from brings.

    Args:
        fewer: with the settings' share of the decisions, and a rate higher by as much (SAC).
        evaluations: after so many it ends, of the usual ones.
    """
    from enn.reinforcement.rehearsal import REHEARSAL
    from enn.reinforcement.training import DESK_PPO

    settings = job.settings
    share = settings.share_of_decisions if fewer and settings.algorithm == SAC else 1.0
    every = math.ceil(share * settings.decisions / EVALUATIONS)
    decisions = min(evaluations * every, math.ceil(share * settings.decisions))
    # without demonstrations, whose actions would be cloned, it has to explore
    preset = replace(
        DESK_PPO,
        keys=ROADMAP_KEYS,
        learning_rate=3e-4,
        log_std_init=0.0,
        log_std_final=None,
        reward_scale=1.0,
        ent_coef=0.003,
        cloning_weight=0.0,
    )
    if settings.algorithm == SAC:
        rate = REHEARSAL.learning_rate / share
        preset = replace(REHEARSAL, learning_rate=rate, buffer_size=max(decisions, 1000))
    training = replace(
        preset,
        hidden=(settings.hidden, settings.hidden),
        decisions=decisions,
        n_envs=settings.environments,
        threads=threads_of(settings),
        evaluate_every=every,
        evaluation_episodes=settings.validation_copies + 1,
        keep_latest=True,
        tensorboard=True,
        device=device,
    )
    return with_hyperparameters(training, settings.training)


def held_steps(job: RehearsalJob) -> int:
    """Steps for which the training holds an action: as the policy that it starts from does."""
    from enn.policy import Policy

    return training_settings(job, "cpu").action_repeat if job.start is None else Policy.load(job.start).action_repeat
