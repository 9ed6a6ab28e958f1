"""The rehearsal stage: a policy is trained in perturbed copies of a patient's scan, and tested in other copies."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from enn.device_trials import TrialStatistics
from pipeline.anatomies.anatomy_file import load_anatomy
from pipeline.anatomies.devices import fitted_steps, fitted_task, with_catheter_where_steep
from pipeline.anatomies.settings import check_anatomies, settle
from pipeline.jobs.pool import Job, run_jobs
from pipeline.jobs.worker import POLICIES
from pipeline.recording.trials import POLICY, Origin
from pipeline.seeds import held_out_copies
from pipeline.stages import Stage, StageContext
from pipeline.stages.job_memory import policy_gb
from pipeline.stages.learning.settings import with_hyperparameters
from pipeline.stages.rehearsal.copies import COPIES, SCAN, RehearsalJob
from pipeline.stages.rehearsal.episodes import film_scan, play
from pipeline.stages.rehearsal.settings import RehearsalSettings
from pipeline.stages.rehearsal.start import (
    advising_policies,
    policy_hashes,
    starting_policy,
    with_chosen_devices,
    with_devices_of,
)
from pipeline.stages.rehearsal.training import (
    DEMONSTRATIONS,
    EXPERT,
    demonstrate,
    train,
)
from pipeline.store.errors import ConfigurationError
from pipeline.tables import Figure, Results
from pipeline.task import Task, require_feeder, require_known_task

BEFORE, AFTER = "before", "after"
TRAINING, FILM = "training", "film"
_LOGGER = logging.getLogger(__name__)
_PARTS = 2  # of the tests in copies, beside each other


def check_rehearsal(settings: RehearsalSettings) -> None:
    """Refuses unknown anatomies, wires and hyper-parameters, and actions of the tip's motors."""
    check_anatomies(settings)
    require_known_task(settings.task)
    require_feeder(settings.task, "rehearsal")
    if settings.training:  # now, and not after the devices' trials
        from enn.reinforcement.rehearsal import REHEARSAL

        with_hyperparameters(REHEARSAL, settings.training)


def run_rehearsal(settings: RehearsalSettings, context: StageContext) -> Results:
    """Tests the policy to start from in the scan and its copies, rehearses, and tests again."""
    try:
        phantom = load_anatomy(settings.anatomy(settings.phantoms[0]))
        target = settings.targets[0]
        phantom.entry(settings.task.entry)
        choose = settings.choose_catheter and settings.policy is None  # a policy of the settings has its devices
        base_task = settings.task if settings.policy is None else with_devices_of(Path(settings.policy), settings.task)
        task = fitted_task(base_task, phantom, [target])
        task = fitted_steps(task, phantom, target) if settings.fit_steps else task
        task, statistics = (
            with_chosen_devices(settings, context, phantom, target, task)
            if choose
            else (with_catheter_where_steep(phantom, target, task, choose=False), None)
        )
        start = starting_policy(settings, context.run_path, context.seed, task)
        advisers = advising_policies(context.run_path, context.seed, task, start) if settings.demonstrations else []
    except ValueError as error:
        raise ConfigurationError(str(error)) from error
    _LOGGER.info("it starts from %s", "nothing" if start is None else start)
    _LOGGER.info("a newton and step cost %g in the training", settings.price_of_force(task, statistics))
    jobs = plan(settings, context, task, target, start, advisers, statistics)
    label = f"rehearsal in {phantom.name}"
    outcomes = run_jobs(
        context.folder, jobs, workers=settings.workers, label=label, preload=POLICIES, device=settings.device
    )
    played = (AFTER,) if start is None else (BEFORE, AFTER)
    rows = {
        f"{phantom.name}/{tested} {kind}": row(outcomes, tested, kind) for tested in played for kind in (SCAN, COPIES)
    }
    origin = "nothing" if start is None else "a policy"
    demonstration_counts = {name: arrived for name, (_, arrived) in outcomes.get(DEMONSTRATIONS, {}).items()}
    if demonstration_counts and not any(demonstration_counts.values()):
        _LOGGER.warning(
            "%s brought these devices to %s in any copy of %s: nothing was shown to the training",
            "neither a policy nor the sampling expert" if EXPERT in demonstration_counts else "no policy",
            target,
            phantom.name,
        )
    demonstration_text = ", ".join(f"{name} {count}" for name, count in demonstration_counts.items() if count) or "none"
    devices = {"wire": task.wire, "catheter": task.catheter or "none"}
    cost = outcomes[TRAINING] | {"starts_from": origin, **devices, "demonstrations": demonstration_text}
    figures = [picture(outcomes, tested, phantom, target, context.path) for tested in played]
    if FILM in outcomes:
        outcome = "arrives" if outcomes[FILM]["arrived"] else "does not arrive"
        caption = f"An episode in the scan, which {outcome}."
        figures.append(Figure(f"{phantom.name}, {AFTER} the rehearsal, film", caption, f"{AFTER}.gif"))
    return Results({"rehearsal": rows, "rehearsal_cost": {phantom.name: cost}}, figures)


def plan(
    settings: RehearsalSettings,
    context: StageContext,
    task: Task,
    target: str,
    start: Path | None,
    demonstrators: Sequence[Path] = (),
    trial_statistics: TrialStatistics | None = None,
) -> list[Job]:
    """The jobs: demonstrations by other policies, tests before, the training, tests after."""
    origin = Origin("rehearsal", AFTER, context.seed, context.budget)
    job = RehearsalJob(context.path, origin, settings, task, target, start, trial_statistics=trial_statistics)
    jobs: list[Job] = []
    if settings.demonstrations and (demonstrators or settings.expert != "never"):
        given = replace(job, demonstrators=tuple(demonstrators))
        jobs.append(Job(DEMONSTRATIONS, demonstrate, given))
    after = tuple(one.key for one in jobs)
    memory = policy_gb(settings.task.image_size_px, 0)
    jobs.append(Job(TRAINING, train, job, after=after, gpu_gb=memory))
    jobs += [] if start is None else _tests(job, BEFORE, start, ())
    trained = job.own_folder / POLICY
    tests = _tests(job, AFTER, trained, (TRAINING,))
    if settings.film:  # the longest of them: first of those that can start beside others
        filmed = replace(job, policy=trained, tested=AFTER)
        tests.insert(1, Job(FILM, film_scan, filmed, after=(f"{AFTER}/{SCAN}",)))
    jobs += tests
    return jobs


def _tests(job: RehearsalJob, tested: str, policy: Path, after: tuple[str, ...]) -> list[Job]:
    copies = held_out_copies(job.settings.test_copies)
    sets = {f"{tested}/{SCAN}": (0,)} | {
        f"{tested}/{COPIES}{part}": tuple(copies[part::_PARTS]) for part in range(min(_PARTS, len(copies)))
    }
    return [
        Job(key, play, replace(job, policy=policy, tested=tested, copies=those), after=after)
        for key, those in sets.items()
    ]


def _outcomes_of(outcomes: dict[str, Any], tested: str, kind: str) -> list[dict[str, Any]]:
    return [outcome for key, outcome in outcomes.items() if key.startswith(f"{tested}/{kind}")]


def row(outcomes: dict[str, Any], tested: str, kind: str) -> dict[str, Any]:
    """A row of the table: success in the first attempt with Wilson's 95 % interval, in any, depth, forces of steps."""
    from cathsim.metrics.episodes import wilson_interval

    parts = _outcomes_of(outcomes, tested, kind)
    success, within = ([one for part in parts for one in part[key]] for key in ("success", "within_attempts"))
    episodes = [forces for part in parts for forces in part["forces"]]
    forces = np.concatenate(episodes)
    low, high = wilson_interval(sum(success), len(success))
    return {
        "success_pct": 100.0 * float(np.mean(success)),
        "interval_pct": f"{100 * low:.0f} to {100 * high:.0f}",
        "within_attempts_pct": 100.0 * float(np.mean(within)),
        "depth_mm": 1e3 * float(np.median([one for part in parts for one in part["depths"]])),
        "force_n": float(forces.mean()),
        "force_p95_n": float(np.percentile(forces, 95)),
        "force_max_n": float(forces.max()),
        "episode_length_steps": float(np.mean([len(one) for one in episodes])),
        "n": len(success),
    }


def picture(outcomes: dict[str, Any], tested: str, phantom: Any, target: Any, folder: Path) -> Figure:
    """Draws the tip's paths and the forces in the copies of a test."""
    from pipeline.plots.episodes import draw_task

    parts = _outcomes_of(outcomes, tested, COPIES)
    logs = [Path(log) for part in parts for log in part["logs"]]
    file = f"{tested}.png"
    draw_task(phantom, target, logs, folder / file)
    reached = sum(sum(part["within_attempts"]) for part in parts)
    caption = f"{reached} of {len(logs)} copies reached; the lumen is the scan's."
    return Figure(f"{phantom.name}, {tested} the rehearsal", caption, file)


STAGE = Stage(
    settings=RehearsalSettings,
    run=run_rehearsal,
    uses=("unseen",),
    prepare=settle,
    check=check_rehearsal,
    further_inputs=policy_hashes,
)
