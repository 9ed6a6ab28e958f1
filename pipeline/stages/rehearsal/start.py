"""What a rehearsal starts from: a policy that is given, the run's own or one that comes with enn, and its devices.

Policies of the wire alone and of a catheter over it play in copies of the scan first. Where no catheter is named, and
there are policies for several devices to start from, `gentlest` chooses. Where none of them reaches the target, and
where there are no such policies, the shape of the take-off decides.
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from enn.device_trials import Trial, TrialStatistics, gentlest, try_in_copies, try_until_gentle
from pipeline.anatomies.devices import CATHETER, SOFTER_WIRES, WITH_POLICIES, softened, with_catheter_where_steep
from pipeline.jobs.pool import Job, run_jobs
from pipeline.jobs.worker import POLICIES, Report, map_simulations
from pipeline.recording.trials import POLICY, Origin
from pipeline.seeds import device_trial_seed, training_copies
from pipeline.stages.rehearsal.copies import RehearsalJob, copies_environment
from pipeline.stages.rehearsal.settings import PRESSING, SAC, RehearsalSettings
from pipeline.stages.unseen.task import ROADMAP, ROADMAP_KEYS
from pipeline.stages.unseen.trials import policy_folder
from pipeline.store.provenance import hash_file
from pipeline.task import DESCENDING, TASK, USUAL_PACE, Task, number_of_actions

if TYPE_CHECKING:
    from cathsim.anatomy import Phantom
    from pipeline.stages import StageContext

DEVICES = "devices"  # first part of the jobs' names
WIRE_ALONE = "wire alone"
TRIALS = 8  # copies, in each of which a policy plays an episode; as many more where all that arrive press too hard
PARTS = 2  # of the copies, beside each other

_LOGGER = logging.getLogger(__name__)


def with_chosen_devices(
    settings: RehearsalSettings, context: StageContext, phantom: Phantom, target: str, task: Task
) -> tuple[Task, TrialStatistics | None]:
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
        part_jobs, label = [job for both in parts for job in both], f"devices in {phantom.name}"
        outcomes = run_jobs(context.folder, part_jobs, workers=settings.workers, label=label, preload=POLICIES)
        return [[trial for job in both for trial in outcomes[job.key]] for both in parts]

    def softer() -> Sequence[str]:
        wires = _trials(settings, context, target, _with_softer_wires(task))
        jobs.update(wires)
        return list(wires)

    statistics = try_until_gentle(list(first), softer, play, PRESSING)
    results = ", ".join(f"{name} {one}" for name, one in statistics.items())
    _LOGGER.info("copies of %s in which a policy reached %s, and how it pressed: %s", phantom.name, target, results)
    if not any(one.reached for one in statistics.values()):
        return with_catheter_where_steep(phantom, target, task, choose=True), None
    devices = list(statistics)[gentlest(list(statistics.values()), PRESSING)]
    return jobs[devices].task, statistics[devices]


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


def _part(name: str, job: RehearsalJob, part: int) -> Job:
    return Job(f"{DEVICES}/{name}/{part}", try_devices, replace(job, part=part))


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


def starting_policy(settings: RehearsalSettings, run_path: Path, seed: int, task: Task) -> Path | None:
    """The policy that a rehearsal starts from.

    One that is not given by name must have been trained to steer as many devices: with the same catheter, if there is
    such a one, else with one of the same shape in another size, else with any. The stage unseen's in the same run comes
    first, then those that come with enn.
    """
    if settings.fresh:
        return None
    if settings.policy is not None:
        return Path(settings.policy)
    if settings.algorithm != SAC:  # those policies have learnt by SAC
        return None
    fitting = [file for file in known_policies(run_path, seed) if _read(file).starts(task)]
    start = next(iter(_of_catheter(fitting, task.catheter) or fitting), None)
    if start is not None and _read(start).catheter != task.catheter:
        _LOGGER.info("no policy was trained with a %s: one of a %s steers it", task.catheter, _read(start).catheter)
    return start


def with_devices_of(path: Path, task: Task) -> Task:
    """A task with the catheter that a given policy was trained with, where the task names none.

    A policy may start the training with another catheter than its own, if one is named.
    """
    from enn.policy import Policy

    policy = Policy.load(path)
    own = policy.metadata.get(TASK, {}).get("catheter")
    if own is not None and task.catheter is None:
        task = replace(task, catheter=own)
        _LOGGER.info("%s was trained with a %s over the wire, which is taken here, too", path, own)
    if policy.action_space.shape != (number_of_actions(task),):
        raise ValueError(
            f"stage.policy={path} steers {'both devices' if own else 'a wire alone'}, the task has "
            f"{'a catheter, too' if task.catheter else 'other actions'}: give another policy or other devices"
        )
    return task


def known_policies(run_path: Path, seed: int) -> list[Path]:
    """Policies of many anatomies by a roadmap: the one of a run, if it was trained, before those that are shipped."""
    places = [policy_folder(run_path / name, ROADMAP, seed) / POLICY for name in ("unseen", f"unseen@seed={seed}")]
    return [*[file for file in places if file.is_file()][:1], *shipped_policies()]


def shipped_policies() -> list[Path]:
    """Files of the shipped policies, but those that were trained with a catheter that is no preset's name."""
    from enn.shipped import weight_files

    return [file for file in weight_files() if not (_read(file).catheter or "").endswith(".yaml")]


def advising_policies(run_path: Path, seed: int, task: Task, start: Path | None) -> list[Path]:
    """The policies that may be demonstrators of a rehearsal: those of as many devices and the same pace.

    Where there are none of the same catheter, those of the same shape in another size; else those by a roadmap of
    others: they steer it, too.

    Returns:
        Their files: the one that the rehearsal starts from first, then those by a roadmap, then those by X-ray images.
    """
    steering = [(file, _read(file)) for file in known_policies(run_path, seed)]
    steering = [(file, one) for file, one in steering if one.steers(task)]
    by_roadmap = [file for file, one in steering if one.by_roadmap]
    files = [*by_roadmap, *(file for file, one in steering if one.by_images)]
    known = [file for file in _of_catheter(files, task.catheter) or by_roadmap if file != start]
    return known if start is None else [start, *known]


def _of_catheter(files: Sequence[Path], catheter: str | None) -> list[Path]:
    """Those that were trained with a catheter; else those of its shape in another size; else none."""
    from cathsim.devices.shelf import catheter_shape

    own = [file for file in files if _read(file).catheter == catheter]
    if own or catheter is None:
        return own
    shape = catheter_shape(catheter)
    trained = [(file, _read(file).catheter) for file in files]
    return [file for file, name in trained if name is not None and catheter_shape(name) == shape]


def policy_hashes(run_path: Path) -> dict[str, str]:
    """Hashes of the policies that a rehearsal of any seed may start from: its results depend on them."""
    own = sorted(run_path.glob(f"unseen*/{ROADMAP}/seed*/{POLICY}"))
    return {str(file.relative_to(run_path)): hash_file(file) for file in own} | {
        f"shipped/{file.name}": hash_file(file) for file in shipped_policies()
    }


@dataclass(frozen=True)
class _Trained:
    """What a policy's file says of what it sees and steers; whatever sees neither a roadmap nor images is of no use."""

    by_roadmap: bool
    by_images: bool
    critics: bool
    actions: tuple[int, ...]  # shape of its actions
    catheter: str | None
    pace: str

    def steers(self, task: Task) -> bool:
        """Whether it was trained to steer as many devices as a task has, at its pace; their shapes may differ."""
        return (
            self.actions == (number_of_actions(task),)
            and (self.catheter is None) == (task.catheter is None)
            and self.pace == task.pace
        )

    def starts(self, task: Task) -> bool:
        """Whether a rehearsal of a task can start from it."""
        return self.by_roadmap and self.critics and self.steers(task)


def _read(file: Path) -> _Trained:
    state = file.stat()
    return _read_once(file, state.st_mtime_ns, state.st_size)


@functools.lru_cache(maxsize=64)
def _read_once(file: Path, modified_ns: int, size: int) -> _Trained:
    """Reads a file again only where it has changed."""
    from enn.policy import Policy
    from enn.shipped import read_policy

    policy = read_policy(file)
    trained = policy.metadata.get(TASK, {})
    catheter, pace = trained.get("catheter"), trained.get("pace", USUAL_PACE)
    if isinstance(policy, Policy):
        by_roadmap = policy.keys == ROADMAP_KEYS
        return _Trained(by_roadmap, False, policy.critics, policy.action_space.shape, catheter, pace)
    return _Trained(False, True, False, (policy.policy.settings.actions,), catheter, pace)
