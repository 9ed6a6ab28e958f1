"""Checks of single settings, worded for the user who wrote them, and the mark of those that cannot change results."""

from __future__ import annotations

import dataclasses
from typing import Any

from pipeline.errors import ConfigurationError

# Metadata of a setting that changes how fast results come, never what they are: it stays out of the hash.
NO_EFFECT_ON_RESULTS = {"affects_results": False}


def require_positive(name: str, value: float) -> None:
    """Refuses a setting that is not above zero.

    Args:
        name: the setting as the user writes it, e.g. ``stage.episodes``.
        value: what was given.

    Raises:
        ConfigurationError: when ``value`` is not a positive finite number.
    """
    if not 0 < value < float("inf"):
        raise ConfigurationError(f"{name} must be above zero, got {value}")


def require_unique(name: str, values: list[Any]) -> None:
    """Refuses an empty list or one that names something twice.

    Args:
        name: the setting as the user writes it.
        values: what was given.

    Raises:
        ConfigurationError: when the list is empty or holds a repeated entry.
    """
    if not values:
        raise ConfigurationError(f"{name} is empty: name at least one")
    if len(set(values)) != len(values):
        raise ConfigurationError(f"{name} names something twice: {', '.join(map(str, values))}")


def require_choice(name: str, value: str, choices: tuple[str, ...]) -> None:
    """Refuses a setting that is none of the choices.

    Args:
        name: the setting as the user writes it.
        value: what was given.
        choices: what may be given.

    Raises:
        ConfigurationError: listing the choices.
    """
    if value not in choices:
        raise ConfigurationError(f"{name} has no {value!r}: choose from {', '.join(choices)}")


def require_modalities(*sets: str) -> None:
    """Refuses what is no set of modalities.

    Args:
        sets: as the user writes them, e.g. ``I+V+M``.

    Raises:
        ConfigurationError: listing the valid sets.
    """
    from enn.features import modality_keys

    for modalities in sets:
        try:
            modality_keys(modalities)
        except ValueError as error:
            raise ConfigurationError(str(error)) from error


def settings_that_matter(settings: Any) -> dict[str, Any]:
    """Lists a stage's settings without those that cannot change its results.

    Args:
        settings: a stage's settings dataclass.

    Returns:
        Field name to value.
    """
    return {
        item.name: getattr(settings, item.name)
        for item in dataclasses.fields(settings)
        if item.metadata.get("affects_results", True)
    }
