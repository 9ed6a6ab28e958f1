"""A rehearsal's job, the environments over copies of the scan that it takes place in, and its hyper-parameters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from enn.curves import chosen_logger
from pipeline.anatomies.anatomy_file import load_anatomy
from pipeline.jobs.engines.local import available_workers
from pipeline.recording.trials import Origin
from pipeline.seeds import training_copies
from pipeline.stages.learning.settings import with_hyperparameters
from pipeline.stages.rehearsal.settings import RehearsalSettings
from pipeline.stages.unseen.task import REWARD_OF_EVALUATION, REWARD_OF_TRAINING, ROADMAP_KEYS
from pipeline.task import Task

if TYPE_CHECKING:
    from cathsim.rehearsal.environment import NavigateCopiesEnv
    from enn.device_trials import TrialStatistics
    from enn.reinforcement.rehearsal_rules import RehearsalRules
    from enn.reinforcement.training.settings import TrainingSettings


SCAN, COPIES = "scan", "copies"  # sets of tests, and their folders


@dataclass(frozen=True)
class RehearsalJob:
    """A rehearsal."""

    folder: Path
    origin: Origin
    settings: RehearsalSettings
    task: Task  # with the length of the wire filled in
    target: str
    start: Path | None = None  # the policy to start from; None: from nothing
    policy: Path | None = None
    tested: str | None = None  # for tests, the row of the table; None: for the training
    copies: tuple[int, ...] = ()  # of a test: seeds
    # Policies that may demonstrate; the first is `start`, where there is one.
    demonstrators: tuple[Path, ...] = ()
    part: int = 0  # of trials: its number among those that are made beside each other
    # How the policy to start from did in the trials of its devices; None: there were none.
    trial_statistics: TrialStatistics | None = None

    @property
    def training_cases(self) -> tuple[int, ...]:
        """The copies of the training, in the order of its cases: the scan itself and others."""
        return (0, *training_copies(self.origin.training_seed, self.settings.copies))

    @property
    def rules(self) -> RehearsalRules:
        """Who demonstrates, and how long is trained."""
        from enn.reinforcement.rehearsal_rules import RehearsalRules

        return RehearsalRules(demonstrations=self.settings.demonstrations, expert=self.settings.expert)

    @property
    def own_folder(self) -> Path:
        return self.folder / f"seed{self.origin.training_seed}"


def copies_environment(
    job: RehearsalJob,
    copies: Sequence[int],
    *,
    training: bool = False,
    observe_every: int = 1,
    observation: Sequence[str] = ROADMAP_KEYS,
) -> NavigateCopiesEnv:
    """An environment over copies; that of a training has the shaped reward and its physics."""
    from cathsim.rehearsal.environment import NavigateCopiesEnv, Perturbation

    settings = job.settings
    perturbation = Perturbation(
        walls=settings.walls_mm / 1e3,
        shift=settings.shift_mm / 1e3,
        turn=math.radians(settings.turn_deg),
        stiffness=settings.stiffness_pct / 100,
        friction=settings.friction_pct / 100,
        breathing=settings.breathing_mm / 1e3,
        period=settings.breath_s,
    )
    shaped: dict[str, Any] = {
        "force_penalty": settings.price_of_force(job.task, job.trial_statistics),
        "force_threshold": settings.force_threshold_n,
        "path_penalty": settings.path_penalty,
    }
    return NavigateCopiesEnv(
        load_anatomy(settings.anatomy(settings.phantoms[0])),
        (job.target,),
        copies=tuple(copies),
        perturbation=perturbation,
        accuracy=settings.accuracy if training else "accurate",
        observation=tuple(observation),
        reward=REWARD_OF_TRAINING if training else REWARD_OF_EVALUATION,
        observe_every=observe_every,
        **(shaped if training else {}),
        **job.task.devices(),
        **job.task.rules(),
    )


MOST_THREADS = 4  # of a training, unless the settings say; more gain nothing (docs/results/computing.md)


def threads_of(settings: RehearsalSettings) -> int:
    """Threads that step the environments: as many as there are cores, within reason."""
    return settings.threads or min(available_workers(), MOST_THREADS)


def training_settings(
    job: RehearsalJob, device: str, *, fewer: bool = False, evaluations: int | None = None
) -> TrainingSettings:
    """Settings of the training but for its start's; `fewer`: a share of the decisions at a higher rate (SAC)."""
    settings = job.settings
    share = settings.share_of_decisions if fewer else 1.0
    training = replace(
        job.rules.training(settings.algorithm, settings.decisions, share=share, evaluations=evaluations),
        hidden=(settings.hidden, settings.hidden),
        n_envs=settings.environments,
        threads=threads_of(settings),
        evaluation_episodes=settings.validation_copies + 1,
        logger=chosen_logger(),
        device=device,
    )
    return with_hyperparameters(training, settings.training)


def held_steps(job: RehearsalJob) -> int:
    """Steps for which the training holds an action: as the policy that it starts from does."""
    from enn.policy import Policy

    return training_settings(job, "cpu").action_repeat if job.start is None else Policy.load(job.start).action_repeat
