"""The unseen stage: one policy for every target, trained on random anatomies, tested on those it has never seen.

Rows say what a policy sees. `roadmap`: the way, walls, wire, force and tip as the simulator has them; the rows
`roadmap <k>` are the curve's, each trained on k arches for equally many decisions. `image_true_mask`: images without
noise, the lumen always filled, and the simulator's own mask of the wire. `xray`: noisy X-ray images, no mask, and one
contrast run before the episode.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.anatomies.settings import require_known_entry, require_known_phantoms, require_known_targets, settle
from pipeline.evaluations.tables import OWN_TABLES
from pipeline.jobs.pool import Job, run_jobs
from pipeline.jobs.worker import POLICIES
from pipeline.recording.trials import MODES, Origin, log_success
from pipeline.seeds import training_arches, validation_arches
from pipeline.stages import Stage, StageContext
from pipeline.stages.job_memory import policy_gb
from pipeline.stages.unseen.image_policy import ImagePolicyJob, train_image_policy
from pipeline.stages.unseen.roadmap import (
    DEMONSTRATIONS,
    EVALUATIONS,
    STARTS,
    DemonstrationsJob,
    RoadmapJob,
    StartsJob,
    insert_starts,
    policy_to_start_from,
    record_demonstrations,
    train_roadmap,
    training_settings,
)
from pipeline.stages.unseen.settings import GENERALIST, NAVIGATOR, UnseenSettings, shipped_policy
from pipeline.stages.unseen.task import (
    IMAGE,
    ROADMAP,
    VARIETY,
    XRAY,
    UnseenTask,
    with_steep_take_off,
)
from pipeline.stages.unseen.trials import (
    MISREGISTERED,
    UNSEEN,
    PolicyJob,
    cluttered,
    misregistered,
    test_sets,
)
from pipeline.store.errors import ConfigurationError
from pipeline.tables import Results
from pipeline.task import decision_steps, require_feeder, require_known_task

ROADMAP_TESTS = "roadmap tests"
DEMONSTRATED = "lcca"  # the target that is hard to find without
OF_THE_CURVE = 2  # evaluations of its trainings; policies of few anatomies fail, which takes longest
_ARCHES_A_JOB = 16
_PARTS = 2  # jobs that demonstrate beside each other

_SHIPPED = (
    f"Rows roadmap and xray are the policies {GENERALIST} and {NAVIGATOR} that come with enn: shipped, training not "
    "repeated here. Their cards (`enn.card`) have the command of the training; `make all PRETRAINED=0` trains."
)
_MOST_TRIED = 1_000  # arches, to find those with a steep take-off

_LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Run:
    """What all jobs of a run share."""

    settings: UnseenSettings
    folder: Path
    seed: int
    variant: str
    task: UnseenTask
    arches: tuple[int, ...]  # trained in
    validated: tuple[int, ...]

    def origin(self, row: str) -> Origin:
        return Origin("unseen", row, self.seed, self.variant)


def plan(settings: UnseenSettings, folder: Path, run_seed: int, variant: str) -> list[Job]:
    """The jobs in their order: start states, which build the arches, and roadmap policies, the teacher first."""
    task = UnseenTask(settings.learnt_targets(), settings.task, settings.accuracy, settings.arches)
    images = [XRAY] * settings.xray + [IMAGE] * settings.image
    curve = sorted({*settings.curve, settings.anatomies}) if settings.curve else []
    most = max([settings.anatomies, *curve])
    trains = bool(settings.decisions or curve)
    arches, validated = arches_of(settings, run_seed, max(most, settings.image_anatomies if images else 0))
    run = _Run(settings, folder, run_seed, variant, task, tuple(arches), tuple(validated))
    by_images = [_by_images(run, row) for row in images]
    inserted = _starts(run, most) if trains else []
    demonstrations = _demonstrations(run, _keys(inserted)) if trains and DEMONSTRATED in task.targets else []
    prepared = [*inserted, *demonstrations]
    teacher, tests = _roadmap(run, _keys(prepared))
    # policies by images are the longest chain of jobs: next after their teacher
    jobs = [*prepared, teacher, *by_images, tests]
    for count in curve:  # the one with most arches never beside another that keeps as many in memory
        after = _keys(prepared) + ((ROADMAP, *images) if count == most else ())
        jobs.append(_of_the_curve(run, count, after))
    return jobs


def arches_of(settings: UnseenSettings, run_seed: int, count: int) -> tuple[list[int], list[int]]:
    """The arches that are trained in, so many, and those that choose the best policy."""
    least, chosen_by = settings.least_set_back_mm, settings.validation_anatomies
    every = 1 if settings.arches == VARIETY else 2
    if not least:
        return list(training_arches(run_seed, count)), list(validation_arches(chosen_by, every))
    targets, seed_limit = settings.learnt_targets(), _MOST_TRIED
    return (
        with_steep_take_off(training_arches(run_seed, seed_limit), targets, least, count, settings.arches),
        with_steep_take_off(validation_arches(seed_limit // 2, every), targets, least, chosen_by, settings.arches),
    )


def _keys(jobs: Sequence[Job]) -> tuple[str, ...]:
    return tuple(job.key for job in jobs)


def _starts(run: _Run, arches: int) -> list[Job]:
    """Those in the first arches of the training."""
    jobs = []
    for first in range(0, arches, _ARCHES_A_JOB):
        part = run.arches[first : min(first + _ARCHES_A_JOB, arches)]
        starts_job = StartsJob(run.folder / STARTS, run.task, part, run.seed)
        jobs.append(Job(f"{STARTS}/{part[0]}", insert_starts, starts_job))
    return jobs


def _demonstrations(run: _Run, after: tuple[str, ...]) -> list[Job]:
    """The jobs that demonstrate the way in the first training anatomies, so that small policies have some too."""
    anatomies = run.arches[: run.settings.anatomies]
    demonstration_arches = anatomies[: run.settings.demonstrations]
    jobs = []
    for part in range(min(_PARTS, len(demonstration_arches))):
        part_job = DemonstrationsJob(
            folder=run.folder / DEMONSTRATIONS,
            task=run.task,
            anatomies=anatomies,
            demonstrated=demonstration_arches[part::_PARTS],
            target=DEMONSTRATED,
            hold=decision_steps(run.task.task),
            seed=run.seed,
        )
        jobs.append(Job(f"{DEMONSTRATIONS}/{part}", record_demonstrations, part_job, after=after))
    return jobs


def _roadmap(run: _Run, after: tuple[str, ...]) -> list[Job]:
    """The main policy, and its tests as a job of their own, so that the image policies need not wait for them."""
    settings = run.settings
    start, training = policy_to_start_from(settings), None
    if settings.decisions:
        training = training_settings(settings, settings.anatomies, settings.decisions, EVALUATIONS, start)
    tests_job = RoadmapJob(
        folder=run.folder,
        origin=run.origin(ROADMAP),
        task=run.task,
        anatomies=run.arches[: settings.anatomies],
        tests=(*test_sets(settings), *misregistered(settings)),
        settings=training,
        start=None if settings.policy is None else Path(settings.policy),
        validated=run.validated,
    )
    untested, gpu_gb = replace(tests_job, tests=()), policy_gb(settings.task.image_size_px, 0)
    return [
        Job(ROADMAP, train_roadmap, untested, after=after, gpu_gb=gpu_gb),
        Job(ROADMAP_TESTS, train_roadmap, tests_job, after=(ROADMAP,), gpu_gb=gpu_gb),
    ]


def _of_the_curve(run: _Run, count: int, after: tuple[str, ...]) -> Job:
    """A policy of so many arches; all of the curve have equally many decisions."""
    settings, row = run.settings, f"{ROADMAP} {count}"
    job = RoadmapJob(
        folder=run.folder,
        origin=run.origin(row),
        task=run.task,
        anatomies=run.arches[:count],
        tests=(replace(test_sets(settings)[0], modes=("deterministic",)),),
        settings=training_settings(settings, count, settings.curve_decisions, OF_THE_CURVE),
        validated=run.validated,
    )
    return Job(row, train_roadmap, job, after=after, gpu_gb=policy_gb(settings.task.image_size_px, 0))


def _by_images(run: _Run, row: str) -> Job:
    settings = run.settings
    among = cluttered(settings) if row == XRAY else ()
    taken = shipped_policy(NAVIGATOR) if settings.shipped and row == XRAY else None
    image_job = ImagePolicyJob(
        folder=run.folder,
        origin=run.origin(row),
        task=run.task,
        anatomies=run.arches[: settings.image_anatomies if taken is None else settings.anatomies],
        tests=tuple(replace(test, modes=("deterministic",)) for test in (*test_sets(settings), *among)),
        settings=settings,
        start=taken,
    )
    gpu_gb = policy_gb(settings.task.image_size_px, 1)
    return Job(row, train_image_policy, image_job, after=(ROADMAP,), gpu_gb=gpu_gb)


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
    if settings.training:
        training_settings(settings, settings.anatomies, max(settings.decisions, 1))


def run_unseen(settings: UnseenSettings, context: StageContext) -> Results:
    jobs = plan(settings, context.path, context.seed, context.budget)
    if settings.shipped:
        _LOGGER.info("unseen: %s", _SHIPPED)
    outcomes = run_jobs(
        context.folder,
        jobs,
        workers=settings.workers,
        label="anatomies and policies",
        preload=POLICIES,
        device=settings.device,
    )
    tables = {"generalisation_curve": curve(jobs, outcomes)}
    if settings.registration_noise_mm:
        tables["registration"] = registration(settings, outcomes[ROADMAP_TESTS]["tests"])
    log_success({
        f"{key}/{one['target']}/{one['test_set']}": {MODES[0]: one}
        for key, outcome in outcomes.items() for one in outcome.get("tests", ()) if one["mode"] == MODES[0]
    })  # fmt: skip
    notes = dict.fromkeys((*tables, OWN_TABLES["unseen"]), _SHIPPED) if settings.shipped else {}
    return Results(tables, notes=notes)


STAGE = Stage(settings=UnseenSettings, run=run_unseen, prepare=settle, check=check_unseen, repeated=True)
