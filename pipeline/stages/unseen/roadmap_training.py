"""How the roadmap policies of unseen anatomies are trained, and the policy that a training may start from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.stages.learning.hyperparameters import with_hyperparameters
from pipeline.stages.unseen.settings import UnseenSettings
from pipeline.stages.unseen.task import ROADMAP_KEYS
from pipeline.store.errors import ConfigurationError
from pipeline.task import MOTION, TASK, decision_steps, differences, task_from

if TYPE_CHECKING:
    from enn.policy import Policy
    from enn.reinforcement.training import TrainingSettings

EVALUATIONS = 5  # of a training
_ACTS_FIRST = 0.05  # of the decisions, where a training starts from a policy: it fills the replay buffer


def training_settings(
    settings: UnseenSettings,
    anatomies: int,
    decisions: int,
    evaluations: int = EVALUATIONS,
    start: Policy | None = None,
) -> TrainingSettings:
    """Those of the roadmap policies.

    Args:
        anatomies: how many the policy is trained on.
        evaluations: on the validation anatomies, the best of which decides.
        start: the policy that it starts from.
    """
    from enn.reinforcement.rehearsal import MANY_CASES, starting_from

    training = replace(
        MANY_CASES,
        hidden=(settings.hidden, settings.hidden),
        decisions=decisions,
        buffer_size=max(decisions, 1000),
        learning_starts=min(MANY_CASES.learning_starts, decisions // 4),
        action_repeat=decision_steps(settings.task),
        reset_bank_cases=anatomies * len(settings.learnt_targets()),
        evaluate_every=max(decisions // evaluations, 1),
        evaluation_episodes=settings.validation_episodes,
        tensorboard=True,
    )
    if start is not None:
        training = starting_from(training, start, _ACTS_FIRST)
    return with_hyperparameters(training, settings.training)


def policy_to_start_from(settings: UnseenSettings) -> Policy | None:
    """The policy of `stage.policy`, if there is one.

    Raises:
        ConfigurationError: it can't be read, has no critics to train on with, sees something else than a roadmap, or is
            to be taken as it is and was trained for another task.
    """
    if settings.policy is None:
        return None
    from enn.policy import Policy

    try:
        policy = Policy.load(Path(str(settings.policy)))
    except (OSError, ValueError) as error:
        raise ConfigurationError(f"stage.policy={settings.policy} can't be read: {error}") from None
    if policy.keys != ROADMAP_KEYS or (settings.decisions and not policy.critics):
        with_critics = " that was saved with critics" if settings.decisions else ""
        raise ConfigurationError(
            f"stage.policy={settings.policy} is no policy by a roadmap{with_critics}: give such a one"
        )
    task = task_from(policy.metadata.get(TASK))
    if not settings.decisions and task is not None and (differing := differences(settings.task, task, MOTION)):
        values = ", ".join(f"stage.task.{name}={getattr(task, name)}" for name in differing)
        raise ConfigurationError(f"stage.policy={settings.policy} was trained with {values}: give the stage the same")
    return policy
