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

    Source: thesis, section Evaluation Metrics, SPL.
    """
    shortest: dict[Task, float] = {}
    for one in evaluations:
        if one.metrics.success:
            shortest[one.task] = min(one.metrics.path_length, shortest.get(one.task, math.inf))
    return shortest


def summary(evaluations: Sequence[Evaluation], shortest: Mapping[Task, float]) -> dict[str, Any]:
    """Mean and spread over episodes (at least one), by the columns of `cathsim.metrics.Summary`; SPL by task."""
    from cathsim.metrics import summarise

    optimal = [shortest.get(one.task, math.nan) for one in evaluations]
    return summarise([one.metrics for one in evaluations], shortest=optimal).as_dict()


def over_seeds(evaluations: Sequence[Evaluation], shortest: Mapping[Task, float]) -> dict[str, Cell]:
    """Means over the training seeds' means, with standard deviation (n - 1) of several; None without values."""
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
