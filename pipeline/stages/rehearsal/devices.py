"""The devices of a rehearsal: policies of the wire alone and of a catheter over it play in copies of the scan first.

Where no catheter is named, and there are policies for several devices to start from, `gentlest` chooses. Where none of
them reaches the target, and where there are no such policies, the shape of the take-off decides.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from enn.device_trials import Trial, Tried, gentlest, try_in_copies, try_until_gentle
from pipeline.anatomies.devices import CATHETER, SOFTER_WIRES, WITH_POLICIES, softened, with_catheter_where_steep
from pipeline.jobs.pool import Job, run_jobs
from pipeline.jobs.worker import Report, map_simulations
from pipeline.recording.trials import Origin
from pipeline.seeds import device_trial_seed, training_copies
from pipeline.stages.rehearsal.copies import PRELOAD, RehearsalJob, copies_environment
from pipeline.stages.rehearsal.settings import PRESSING
from pipeline.stages.rehearsal.starting_policy import starting_policy
from pipeline.task import DESCENDING, Task

if TYPE_CHECKING:
    from cathsim.anatomy import Phantom
    from pipeline.stages import StageContext
    from pipeline.stages.rehearsal.settings import RehearsalSettings

DEVICES = "devices"  # first part of the jobs' names
WIRE_ALONE = "wire alone"
TRIALS = 8  # copies, in each of which a policy plays an episode; as many more where all that arrive press too hard
PARTS = 2  # of the copies, beside each other
_SECONDS = 5.0  # a guess: of a part of one policy's trials

_LOGGER = logging.getLogger(__name__)


def with_chosen_devices(
    settings: RehearsalSettings, context: StageContext, phantom: Phantom, target: str, task: Task
) -> tuple[Task, Tried | None]:
    """The task with the devices that bring the wire to the target, and says so in the log.

    Returns:
        Also how the policy to start from fared with these devices; None where the shape of the take-off decided.
    """
    in_branch = phantom.target(target).branch != phantom.tree.root.name
    choice = task.catheter is None and task.entry == DESCENDING and in_branch
    first = _trials(settings, context, target, _with_catheters(task)) if choice else {}
    if len(first) < 2:
        return with_catheter_where_steep(phantom, target, task, choose=True), None

    jobs = dict(first)

    def play(names: Sequence[str], turn: int) -> list[list[Trial]]:
        parts = [[_part(name, jobs[name], PARTS * turn + k) for k in range(PARTS)] for name in names]
        asked, label = [job for both in parts for job in both], f"devices in {phantom.name}"
        outcomes = run_jobs(context.folder, asked, workers=settings.workers, label=label, preload=PRELOAD)
        return [[trial for job in both for trial in outcomes[job.key]] for both in parts]

    def softer() -> Sequence[str]:
        wires = _trials(settings, context, target, _with_softer_wires(task))
        jobs.update(wires)
        return list(wires)

    tried = try_until_gentle(list(first), softer, play, PRESSING)
    told = ", ".join(f"{name} {one}" for name, one in tried.items())
    _LOGGER.info("copies of %s in which a policy reached %s, and how it pressed: %s", phantom.name, target, told)
    if not any(one.reached for one in tried.values()):
        return with_catheter_where_steep(phantom, target, task, choose=True), None
    chosen = list(tried)[gentlest(list(tried.values()), PRESSING)]
    return jobs[chosen].task, tried[chosen]


def _with_catheters(task: Task) -> dict[str, Task]:
    """The wire alone, then with each catheter that policies come for, and with a softer one."""
    usual = {catheter or WIRE_ALONE: replace(task, catheter=catheter) for catheter in (None, *WITH_POLICIES)}
    softer = softened(usual[CATHETER])
    return usual | {softer.device_names: softer}


def _with_softer_wires(task: Task) -> dict[str, Task]:
    """Softer wires alone in place of the usual one; a wire that somebody chose stays."""
    return {wire: replace(task, wire=wire) for wire in SOFTER_WIRES if task.wire == Task().wire}


def try_devices(job: RehearsalJob, report: Report) -> list[Trial]:
    """Lets the policy to start from play in the copies of the job's part: every other of eight, or of the next."""
    from enn.policy import Policy

    map_simulations()
    assert job.start is not None
    environment = copies_environment(job, job.copies)
    turn, part = divmod(job.part, PARTS)
    cases, seed = range(TRIALS * turn + part, TRIALS * (turn + 1), PARTS), device_trial_seed(job.origin.training_seed)
    trials = try_in_copies(Policy.load(job.start), environment, seed, cases=cases, tick=report)
    environment.close()
    return trials


def _part(name: str, given: RehearsalJob, part: int) -> Job:
    return Job(f"{DEVICES}/{name}/{part}", try_devices, replace(given, part=part), weight=_SECONDS)


def _trials(
    settings: RehearsalSettings, context: StageContext, target: str, tasks: Mapping[str, Task]
) -> dict[str, RehearsalJob]:
    """Trials of the devices of tasks, by their names, as far as there are policies to start from."""
    origin = Origin("rehearsal", DEVICES, context.seed, context.budget)
    copies = tuple(training_copies(context.seed, 2 * TRIALS))
    trials = {}
    for name, task in tasks.items():
        start = starting_policy(settings, context.run_path, context.seed, task)
        if start is not None:
            trials[name] = RehearsalJob(context.path, origin, settings, task, target, start, copies=copies)
    return trials
