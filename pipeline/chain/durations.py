"""How long stages take: what is known of a budget, and what follows for the rest of a chain on this machine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from omegaconf import OmegaConf

from pipeline.chain.pace import machine_seconds
from pipeline.chain.steps import chosen_value
from pipeline.config import BUDGETS, CONFIG_DIRECTORY

_WORTH_MEASURING = 10.0  # minutes of a chain, before which this machine's pace is measured
_WORKED = 0.3  # of what a stage is known to take: less, and it was up to date or went on from an earlier run


def known_minutes(overrides: Sequence[str]) -> dict[str, float]:
    """Wall minutes of each stage on two cores at the chosen budget, as far as they are known."""
    budget = chosen_value(overrides, "budget", "desk")
    if budget not in BUDGETS:  # the first stage says so
        return {}
    minutes = of_budget(budget).get("minutes") or {}
    return {str(name): float(value) for name, value in minutes.items()}


def minutes_here(stages: Sequence[str], overrides: Sequence[str]) -> tuple[dict[str, float], float]:
    """Wall minutes of each stage on this machine, as far as they are known, and how many times those of the budget.

    Args:
        stages: of a chain; where they are short, or the budget's machine is not known, nothing is measured.
    """
    known = known_minutes(overrides)
    reference = of_budget(chosen_value(overrides, "budget", "desk")).get("machine_seconds") if known else None
    if reference is None or sum(known.get(name, 0.0) for name in stages) < _WORTH_MEASURING:
        return known, 1.0
    seconds = machine_seconds()
    pace = 1.0 if seconds is None else seconds / float(reference)
    return {name: pace * minutes for name, minutes in known.items()}, pace


def of_budget(budget: str) -> Any:
    """The settings of a budget, as its file has them."""
    return OmegaConf.load(CONFIG_DIRECTORY / "budget" / f"{budget}.yaml")


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
