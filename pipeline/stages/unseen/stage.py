"""The unseen stage: one policy for every target, trained on random anatomies, tested on those it has never seen.

Rows say what a policy sees. `roadmap`: the way, walls, wire, force and tip as the simulator has them; the rows
`roadmap <k>` are the curve's, each trained on k arches for equally many decisions. `image_true_mask`: images without
noise, the lumen always filled, and the simulator's own mask of the wire. `xray`: noisy X-ray images, no mask, and one
contrast run before the episode.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.anatomies.settings import require_known_entry, require_known_phantoms, require_known_targets, settle
from pipeline.evaluations.tables import log_summary
from pipeline.jobs.pool import Job, run_jobs
from pipeline.stages import Stage, StageContext
from pipeline.stages.unseen.plan import ROADMAP_TESTS, plan
from pipeline.stages.unseen.roadmap import PRELOAD, RoadmapJob, policy_to_start_from
from pipeline.stages.unseen.settings import UnseenSettings
from pipeline.stages.unseen.task import IMAGE, ROADMAP, VARIETY, XRAY
from pipeline.stages.unseen.trials import MISREGISTERED, UNSEEN, PolicyJob
from pipeline.store.errors import ConfigurationError
from pipeline.tables import Results
from pipeline.task import require_feeder, require_known_task

CURVE = "roadmap_curve"  # in the table of the curve: the policies with equally many decisions


def registration(settings: UnseenSettings, tests: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Row "<noise> mm" to success of the roadmap policy on unseen arches with that error of its registration."""
    table = {}
    for noise in settings.registration_noise_mm:
        name = f"{MISREGISTERED} {noise:g} mm" if noise else UNSEEN
        table[f"{noise:g} mm"] = _success(tests, name)
    return table


def curve(jobs: Sequence[Job], outcomes: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Row "<policy>/<number of training anatomies>" to success on unseen arches; the curve's are first."""
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


def check_unseen(settings: UnseenSettings) -> None:
    """Refuses unknown phantoms, targets, wires and views."""
    from cathsim import GUIDEWIRES
    from cathsim.fluoroscopy.projector import VIEWS

    policy_to_start_from(settings)
    require_known_targets(settings.targets)
    if settings.arches == VARIETY and settings.file is not None:
        raise ConfigurationError(f"stage.arches={VARIETY} tries policies in such arches alone: leave phantom.file out")
    if settings.file is None:
        require_known_phantoms(settings.phantoms)
        if settings.phantoms:
            require_known_targets(settings.tested_targets(), settings.phantoms)
        require_known_entry(settings.own_entry, settings.phantoms)
    wires = (*GUIDEWIRES, "softer", "stiffer")
    unknown = [name for name in settings.wires if name not in wires]
    if unknown:
        raise ConfigurationError(f"unknown wire {', '.join(map(repr, unknown))}: choose from {', '.join(wires)}")
    unknown = [name for name in settings.views if name not in VIEWS]
    if unknown:
        raise ConfigurationError(f"unknown view {', '.join(map(repr, unknown))}: choose from {', '.join(VIEWS)}")
    require_known_task(settings.task)
    require_feeder(settings.task, "unseen")


def run_unseen(settings: UnseenSettings, context: StageContext) -> Results:
    """Trains and tests every policy."""
    jobs = plan(settings, context.path, context.seed, context.budget)
    outcomes = run_jobs(
        context.folder,
        jobs,
        workers=settings.workers,
        label="anatomies and policies",
        preload=PRELOAD,
        device=settings.device,
    )
    tables = {"generalisation_curve": curve(jobs, outcomes)}
    if settings.registration_noise_mm:
        tables["registration"] = registration(settings, outcomes[ROADMAP_TESTS]["tests"])
    log_summary(context.path)
    return Results(tables)


STAGE = Stage(settings=UnseenSettings, run=run_unseen, prepare=settle, check=check_unseen, repeated=True)
