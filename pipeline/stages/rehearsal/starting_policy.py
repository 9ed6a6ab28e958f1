"""The policy that a rehearsal starts from: one given, the run's own, or one that comes with enn."""

from __future__ import annotations

import functools
import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pipeline.recording.trials import POLICY
from pipeline.stages.rehearsal.settings import SAC, RehearsalSettings
from pipeline.stages.unseen.task import ROADMAP, ROADMAP_KEYS
from pipeline.stages.unseen.trials import policy_folder
from pipeline.store.provenance import hash_file
from pipeline.task import TASK, USUAL_PACE, Task, number_of_actions

_LOGGER = logging.getLogger(__name__)


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
    from enn.shipped import weight_files

    places = [policy_folder(run_path / name, ROADMAP, seed) / POLICY for name in ("unseen", f"unseen@seed={seed}")]
    return [*[file for file in places if file.is_file()][:1], *weight_files()]


def advising_policies(run_path: Path, seed: int, task: Task, start: Path | None) -> list[Path]:
    """The policies that may show a rehearsal how its target is reached: those of as many devices and the same pace.

    Where there are none of the same catheter, those of the same shape in another size; else those by a roadmap of
    others: they steer it, too.

    Returns:
        Their files: the one that the rehearsal starts from first, then those by a roadmap, then those by X-ray images.
    """
    steering = [(file, _read(file)) for file in known_policies(run_path, seed)]
    steering = [(file, one) for file, one in steering if one.steers(task)]
    by_roadmap = [file for file, one in steering if one.by_roadmap]
    found = [*by_roadmap, *(file for file, one in steering if one.by_images)]
    known = [file for file in _of_catheter(found, task.catheter) or by_roadmap if file != start]
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
    from enn.shipped import weight_files

    own = sorted(run_path.glob(f"unseen*/{ROADMAP}/seed*/{POLICY}"))
    return {str(file.relative_to(run_path)): hash_file(file) for file in own} | {
        f"shipped/{file.name}": hash_file(file) for file in weight_files()
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
