"""How long stages take: what is known of a budget, and what follows for the rest of a chain on this machine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from omegaconf import OmegaConf

from pipeline.chain.steps import chosen_value
from pipeline.config import BUDGETS, CONFIG_DIRECTORY

_WORKED = 0.3  # of what a stage is known to take: less, and it was up to date or went on from an earlier run


def known_minutes(overrides: Sequence[str]) -> dict[str, float]:
    """Wall minutes of each stage on two cores at the chosen budget, as far as they are known."""
    budget = chosen_value(overrides, "budget", "desk")
    if budget not in BUDGETS:  # the first stage says so
        return {}
    sizes: Any = OmegaConf.load(CONFIG_DIRECTORY / "budget" / f"{budget}.yaml")
    minutes = sizes.get("minutes") or {}
    return {str(name): float(value) for name, value in minutes.items()}


def minutes_left(
    waiting: Sequence[str],
    under_way: Sequence[tuple[str, float]],
    spent: Sequence[tuple[str, float]],
    known: Mapping[str, float],
) -> float | None:
    """Estimates the wall time of stages that have not ended.

    Args:
        waiting: stages that have not begun.
        under_way: stages that have, and the minutes of the machine that they had so far: half of those in which one
            other stage ran, too.
        spent: stages that ran, and their minutes of the machine.
        known: minutes of stages alone on the machine they were measured on.

    Returns:
        Minutes; None where one of the stages is not known.
    """
    if any(name not in known for name in (*waiting, *(name for name, _ in under_way))):
        return None
    worked = [(name, minutes) for name, minutes in spent if name in known and minutes > _WORKED * known[name]]
    expected = sum(known[name] for name, _ in worked)
    # short stages tell little of a machine: they count as much as they last, beside one that is as fast as known
    prior = 0.02 * sum(known.values())
    pace = (prior + sum(minutes for _, minutes in worked)) / (prior + expected)
    begun = sum(max(pace * known[name] - minutes, 0.0) for name, minutes in under_way)
    return pace * sum(known[name] for name in waiting) + begun


def worded(minutes: float) -> str:
    """For example ``40 s``, ``12 min`` or ``2 h 05 min``."""
    if minutes < 1:
        return f"{60 * minutes:.0f} s"
    hours, rest = divmod(round(minutes), 60)
    return f"{hours} h {rest:02d} min" if hours else f"{rest} min"
