"""The devices of a rehearsal: policies of the wire alone and of a catheter over it play in copies of the scan first.

Where no catheter is named, and there are policies for several devices to start from, `gentlest` chooses. Where none of
them reaches the target, and where there are no such policies, the shape of the take-off decides.
"""

from __future__ import annotations

import dataclasses
import logging
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from pipeline.anatomies.device_trials import Tried, gentlest, try_in_copies
from pipeline.anatomies.take_offs import WITH_POLICIES, with_catheter_where_steep
from pipeline.jobs.freed_memory import map_simulations
from pipeline.jobs.pool import Job, run_jobs
from pipeline.jobs.worker import Report
from pipeline.recording.trials import Origin
from pipeline.seeds import device_trial_seed, training_copies
from pipeline.stages.rehearsal.copies import RehearsalJob, copies_environment
from pipeline.stages.rehearsal.jobs import PRELOAD
from pipeline.stages.rehearsal.starting_policy import starting_policy
from pipeline.task import DESCENDING, Task

if TYPE_CHECKING:
    from cathsim.anatomy import Phantom
    from pipeline.stages import StageContext
    from pipeline.stages.rehearsal.settings import RehearsalSettings

DEVICES = "devices"  # first part of the jobs' names
WIRE_ALONE = "wire alone"
TRIALS = 4  # copies, in each of which a policy plays an episode
_SECONDS = 10.0  # a guess: of the trials of one policy

_LOGGER = logging.getLogger(__name__)


def with_chosen_devices(
    settings: RehearsalSettings, context: StageContext, phantom: Phantom, target: str, task: Task
) -> tuple[Task, Tried | None]:
    """The task with the devices that bring the wire to the target, and says so in the log.

    Args:
        task: without a catheter the choice is open.

    Returns:
        Also how the policy to start from fared with these devices; None where the shape of the take-off decided.

    Raises:
        ValueError: as of `starting_policy`.
    """
    in_branch = phantom.target(target).branch != phantom.tree.root.name
    choice = task.catheter is None and task.entry == DESCENDING and in_branch
    jobs = _jobs(settings, context, target, task) if choice else []
    if len(jobs) < 2:
        return with_catheter_where_steep(phantom, target, task, choose=True), None
    label = f"devices in {phantom.name}"
    for first in (jobs[:1], jobs):  # the usual devices are enough where they always arrive
        outcomes = run_jobs(context.folder, first, workers=settings.workers, label=label, preload=PRELOAD)
        tried = [Tried(**outcomes[job.key]) for job in first]
        if tried[0].reached == tried[0].episodes:
            break
    fared = ", ".join(f"{job.key.partition('/')[2]} {one}" for job, one in zip(jobs, tried, strict=False))
    _LOGGER.info("copies of %s in which a policy reached %s: %s", phantom.name, target, fared)
    if not any(one.reached for one in tried):
        return with_catheter_where_steep(phantom, target, task, choose=True), None
    chosen = gentlest(tried)
    return jobs[chosen].given.task, tried[chosen]


def try_devices(job: RehearsalJob, report: Report) -> dict[str, Any]:
    """Lets the policy to start from play in the job's copies; returns the fields of `Tried`."""
    from enn.policy import Policy

    map_simulations()
    assert job.start is not None
    environment = copies_environment(job, job.copies)
    tried = try_in_copies(Policy.load(job.start), environment, device_trial_seed(job.origin.training_seed), tick=report)
    environment.close()
    return dataclasses.asdict(tried)


def _jobs(settings: RehearsalSettings, context: StageContext, target: str, task: Task) -> list[Job]:
    """Trials of a task's devices, and of a catheter over its wire, as far as there are policies to start from."""
    origin = Origin("rehearsal", DEVICES, context.seed, context.budget)
    copies = tuple(training_copies(context.seed, TRIALS))
    jobs = []
    for catheter in (None, *WITH_POLICIES):
        own = replace(task, catheter=catheter)
        start = starting_policy(settings, context.run_path, context.seed, own)
        if start is not None:
            given = RehearsalJob(context.path, origin, settings, own, target, start, copies=copies)
            jobs.append(Job(f"{DEVICES}/{catheter or WIRE_ALONE}", try_devices, given, weight=_SECONDS))
    return jobs
