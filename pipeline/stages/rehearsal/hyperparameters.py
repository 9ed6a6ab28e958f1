"""Hyper-parameters of a rehearsal's training, from the stage's settings."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from pipeline.jobs.engines.local import available_workers
from pipeline.stages.learning.hyperparameters import with_hyperparameters
from pipeline.stages.rehearsal.copies import RehearsalJob
from pipeline.stages.rehearsal.settings import RehearsalSettings

if TYPE_CHECKING:
    from enn.reinforcement.training import TrainingSettings

MOST_THREADS = 4  # of a training, unless the settings say; more gain nothing (docs/results/computing.md)


def threads_of(settings: RehearsalSettings) -> int:
    """Threads that step the environments: as many as there are cores, within reason."""
    return settings.threads or min(available_workers(), MOST_THREADS)


def training_settings(
    job: RehearsalJob, device: str, *, fewer: bool = False, evaluations: int | None = None
) -> TrainingSettings:
    """Settings of the training, but for what the policy that it starts from brings.

    Args:
        fewer: with the settings' share of the decisions, and a rate higher by as much (SAC).
        evaluations: after so many it ends; None: the usual ones.
    """
    settings = job.settings
    share = settings.share_of_decisions if fewer else 1.0
    training = replace(
        job.rules.training(settings.algorithm, settings.decisions, share=share, evaluations=evaluations),
        hidden=(settings.hidden, settings.hidden),
        n_envs=settings.environments,
        threads=threads_of(settings),
        evaluation_episodes=settings.validation_copies + 1,
        tensorboard=True,
        device=device,
    )
    return with_hyperparameters(training, settings.training)


def held_steps(job: RehearsalJob) -> int:
    """Steps for which the training holds an action: as the policy that it starts from does."""
    from enn.policy import Policy

    return training_settings(job, "cpu").action_repeat if job.start is None else Policy.load(job.start).action_repeat
