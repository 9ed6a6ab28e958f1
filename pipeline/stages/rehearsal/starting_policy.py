"""The policy that a rehearsal starts from: one given, the run's own, or one that comes with enn."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.recording.trials import POLICY
from pipeline.stages.rehearsal.settings import SAC, RehearsalSettings
from pipeline.stages.unseen.task import ROADMAP, ROADMAP_KEYS
from pipeline.stages.unseen.trials import policy_folder
from pipeline.store.provenance import hash_file
from pipeline.task import TASK, USUAL_PACE, Task, number_of_actions

if TYPE_CHECKING:
    from enn.imitation.images.policy import ImagePolicy
    from enn.policy import Policy

_LOGGER = logging.getLogger(__name__)


def starting_policy(settings: RehearsalSettings, run_path: Path, seed: int, task: Task) -> Path | None:
    """The policy that a rehearsal starts from.

    One that is not given by name must have been trained to steer as many devices: with the same catheter, if there is
    such a one, else with another. The stage unseen's in the same run comes first, then those that come with enn.

    Returns:
        Its file; None: nothing fits, or nothing is wanted.

    Raises:
        ValueError: the run's own, or a shipped one, is damaged or of a format that this version does not read.
    """
    if settings.fresh:
        return None
    if settings.policy is not None:
        return Path(settings.policy)
    if settings.algorithm != SAC:  # those policies have learnt by SAC
        return None
    fitting = [file for file in known_policies(run_path, seed) if _fits(file, task)]
    start = next((file for file in fitting if _has_catheter(file, task)), next(iter(fitting), None))
    if start is not None and not _has_catheter(start, task):
        _LOGGER.info("no policy was trained with a %s: one of another catheter steers it", task.catheter)
    return start


def with_devices_of(path: Path, task: Task) -> Task:
    """A task with the catheter that a given policy was trained with, where the task names none.

    A policy may start the training with another catheter than its own, if one is named.

    Raises:
        ValueError: it is no policy by a roadmap, or steers another number of devices than the task has.
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

    Where there are none of the same catheter, those by a roadmap of another: they steer it, too.

    Returns:
        Their files: the one that the rehearsal starts from first, then those by a roadmap, then those by X-ray images.

    Raises:
        ValueError: as of `starting_policy`.
    """
    from enn.policy import Policy
    from enn.shipped import read_policy

    by_roadmap, by_images = [], []
    for file in known_policies(run_path, seed):
        policy = read_policy(file)
        if _steers(policy, task):
            if not isinstance(policy, Policy):
                by_images.append(file)
            elif policy.keys == ROADMAP_KEYS:
                by_roadmap.append(file)
    found = [*by_roadmap, *by_images]
    own = [file for file in found if _has_catheter(file, task)]
    known = [file for file in own or by_roadmap if file != start]
    return known if start is None else [start, *known]


def policy_hashes(run_path: Path) -> dict[str, str]:
    """Hashes of the policies that a rehearsal of any seed may start from: its results depend on them."""
    from enn.shipped import weight_files

    own = sorted(run_path.glob(f"unseen*/{ROADMAP}/seed*/{POLICY}"))
    return {str(file.relative_to(run_path)): hash_file(file) for file in own} | {
        f"shipped/{file.name}": hash_file(file) for file in weight_files()
    }


def _fits(file: Path, task: Task) -> bool:
    """Whether a policy sees a roadmap, has its critics, and steers the devices of a task."""
    from enn.policy import Policy
    from enn.shipped import read_policy

    policy = read_policy(file)
    return isinstance(policy, Policy) and policy.keys == ROADMAP_KEYS and policy.critics and _steers(policy, task)


def _steers(policy: Policy | ImagePolicy, task: Task) -> bool:
    """Whether a policy was trained to steer as many devices as a task has, at its pace; their shapes may differ."""
    from enn.policy import Policy

    actions = policy.action_space.shape if isinstance(policy, Policy) else (policy.policy.settings.actions,)
    trained = policy.metadata.get(TASK, {})
    return (
        actions == (number_of_actions(task),)
        and (trained.get("catheter") is None) == (task.catheter is None)
        and trained.get("pace", USUAL_PACE) == task.pace
    )


def _has_catheter(file: Path, task: Task) -> bool:
    """Whether a policy was trained with the catheter of a task, or with none where the task has none."""
    from enn.shipped import read_policy

    trained: str | None = read_policy(file).metadata.get(TASK, {}).get("catheter")
    return trained == task.catheter
