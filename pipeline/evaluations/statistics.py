"""Statistics over evaluations: shortest paths for SPL, means and spread over training seeds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pipeline.evaluations.logs import DEMONSTRATION, Evaluation, Task
from pipeline.tables import Cell, mean_of


def shortest_paths(evaluations: Sequence[Evaluation]) -> dict[Task, float]:
    """Finds the shortest path by which any successful episode reached each target: the optimum of SPL for all policies.

    Args:
        evaluations: all of a run, demonstrations, the sampling expert's and people's among them.

    Returns:
        Task to m. Episodes share a task when phantom, target, entry, wire, start and success radius agree.

    Source: thesis, section Evaluation Metrics, SPL.
    """
    shortest: dict[Task, float] = {}
    for one in evaluations:
        if one.metrics.success:
            shortest[one.task] = min(one.metrics.path_length, shortest.get(one.task, math.inf))
    return shortest


def summary(evaluations: Sequence[Evaluation], shortest: Mapping[Task, float]) -> dict[str, Any]:
    """Mean and standard deviation over episodes, by the columns of `cathsim.metrics.Summary`.

    Args:
        evaluations: at least one.
        shortest: from `shortest_paths`; SPL takes the path of each episode's own task.
    """
    from cathsim.metrics import summarise

    optimal = [shortest.get(one.task, math.nan) for one in evaluations]
    return summarise([one.metrics for one in evaluations], shortest=optimal).as_dict()


def over_seeds(evaluations: Sequence[Evaluation], shortest: Mapping[Task, float]) -> dict[str, Cell]:
    """Means over the training seeds' means, with their standard deviation.

    Args:
        evaluations: of one mode, at least one.
        shortest: from `shortest_paths`.

    Returns:
        The columns of `summary` and `contact_force_n`; [mean, standard deviation with n - 1 in the denominator] where
        there are several seeds, else the mean alone. None where there is nothing to average.
    """
    seeds: dict[int, list[Evaluation]] = {}
    for one in evaluations:
        seeds.setdefault(one.training_seed, []).append(one)
    means: dict[str, list[float]] = {}
    for of_seed in seeds.values():
        for name, value in summary(of_seed, shortest).items():
            if value is not None:
                means.setdefault(name, []).append(mean_of(value))
        contacts = [one.contact_force for one in of_seed if one.contact_force is not None]
        if contacts:
            means.setdefault("contact_force_n", []).append(float(np.mean(contacts)))
    unknown = dict.fromkeys(("contact_force_n", "success_lumen_pct", "depth_mm"))
    return {**unknown, **{name: _mean_and_spread(values) for name, values in means.items()}}


def _mean_and_spread(values: list[float]) -> Cell:
    mean = float(np.mean(values))
    return [mean, float(np.std(values, ddof=1))] if len(values) > 1 else mean


def of_mode(evaluations: Sequence[Evaluation], mode: str) -> list[Evaluation]:
    """Those of one mode, "deterministic" or "stochastic"."""
    return [one for one in evaluations if one.mode == mode]


def counted(evaluations: Sequence[Evaluation]) -> list[Evaluation]:
    """Those that belong to a row: all but demonstrations."""
    return [one for one in evaluations if one.mode != DEMONSTRATION]
