"""Hyper-parameters of a training from the command line: ``'stage.training={learning_rate: 3e-4, n_envs: 4}'``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any

from pipeline.store.errors import ConfigurationError

if TYPE_CHECKING:
    from enn.reinforcement import TrainingSettings

# Have settings of their own, or follow from the task.
_ELSEWHERE = (
    "algorithm",
    "keys",
    "critic_keys",
    "passthrough",
    "decisions",
    "device",
    "tensorboard",
    "reset_bank_cases",
)


def with_hyperparameters(training: TrainingSettings, changes: Mapping[str, Any] | None) -> TrainingSettings:
    """A training with some of its settings changed.

    Args:
        changes: field of `SacSettings` or `PpoSettings` to value; a list is taken as a tuple. None: nothing changes.

    Raises:
        ConfigurationError: there is no such field, or it cannot have that value.
    """
    if not changes:
        return training
    known = [field.name for field in fields(training) if field.name not in _ELSEWHERE]
    unknown = [name for name in changes if name not in known]
    if unknown:
        raise ConfigurationError(f"stage.training has no {unknown[0]!r}: choose from {', '.join(known)}")
    values: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in changes.items()
    }
    try:
        return replace(training, **values)
    except ValueError as error:
        raise ConfigurationError(f"stage.training: {error}") from error
