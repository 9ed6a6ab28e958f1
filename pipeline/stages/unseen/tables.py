"""Tables of the stage `unseen`: success by training anatomies, and by the error of the roadmap's registration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.jobs.pool import Job
from pipeline.stages.unseen.jobs import RoadmapJob
from pipeline.stages.unseen.settings import UnseenSettings
from pipeline.stages.unseen.task import IMAGE, ROADMAP, XRAY
from pipeline.stages.unseen.trials import PolicyJob

CURVE = "roadmap_curve"  # in the table of the curve: the policies with equally many decisions
UNSEEN, MISREGISTERED, CLUTTERED = "unseen", "misregistered", "unseen clutter"  # sets of tests


def registration(settings: UnseenSettings, tests: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Success of the roadmap policy on unseen arches by the error of its registration.

    Args:
        tests: rows of the roadmap policy's tests.

    Returns:
        Row "<noise> mm" to columns.
    """
    table = {}
    for noise in settings.registration_noise_mm:
        name = f"{MISREGISTERED} {noise:g} mm" if noise else UNSEEN
        table[f"{noise:g} mm"] = _success(tests, name)
    return table


def curve(jobs: Sequence[Job], outcomes: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Success on unseen arches by policy, with the anatomies and the decisions that it was trained with.

    Args:
        outcomes: a job's key to its result.

    Returns:
        Row "<policy>/<number of training anatomies>" to columns; those of the curve first, all of one number of
        decisions.
    """
    table: dict[str, dict[str, Any]] = {}
    for job in sorted(jobs, key=_place):
        if not isinstance(job.given, PolicyJob) or not job.given.tests:
            continue
        row, anatomies = job.given.origin.row, len(job.given.anatomies)
        kind = CURVE if row.startswith(f"{ROADMAP} ") else row
        training = job.given.settings if isinstance(job.given, RoadmapJob) else None
        decisions = None if training is None else training.decisions
        success = _success(outcomes[job.key]["tests"], UNSEEN)
        table[f"{kind}/{anatomies}"] = {"decisions": decisions, **success}
    return table


def _place(job: Job) -> tuple[int, int]:
    """Where a policy stands in the curve's table: the curve's by their arches, the main one, the image policies."""
    row = getattr(getattr(job.given, "origin", None), "row", "")
    order = [ROADMAP, IMAGE, XRAY]
    return (1 + order.index(row), 0) if row in order else (0, len(getattr(job.given, "anatomies", ())))


def _success(tests: Sequence[dict[str, Any]], test_set: str) -> dict[str, Any]:
    """Success in a set of tests: of all targets together, and of each."""
    rows = [row for row in tests if row["test_set"] == test_set and row["mode"] == "deterministic"]
    together = float(np.average([row["success_pct"] for row in rows], weights=[row["n"] for row in rows]))
    each = {f"success_{row['target']}_pct": row["success_pct"] for row in rows if row["target"] != "lsa"}
    return {"success_pct": together, **each, "n": sum(row["n"] for row in rows)}
