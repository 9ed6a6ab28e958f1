"""The policy that a rehearsal starts from: one given, the run's own, or one that comes with enn."""

from __future__ import annotations

from pathlib import Path

from pipeline.recording.trials import POLICY
from pipeline.stages.rehearsal.settings import SAC, RehearsalSettings
from pipeline.stages.unseen.task import ROADMAP, ROADMAP_KEYS
from pipeline.stages.unseen.trials import policy_folder
from pipeline.store.provenance import hash_file
from pipeline.task import TASK, Task, number_of_actions


def starting_policy(settings: RehearsalSettings, run_path: Path, seed: int, task: Task) -> Path | None:
    """The policy that a rehearsal starts from.

    One that is not given by name must have been trained with the same devices: the stage unseen's in the same run
    first, then those that come with enn.

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
    return next((file for file in known_policies(run_path, seed) if _fits(file, task)), None)


def known_policies(run_path: Path, seed: int) -> list[Path]:
    """Policies of many anatomies by a roadmap: the one of a run, if it was trained, before those that are shipped."""
    from enn.shipped import weight_files

    places = [policy_folder(run_path / name, ROADMAP, seed) / POLICY for name in ("unseen", f"unseen@seed={seed}")]
    return [*[file for file in places if file.is_file()][:1], *weight_files()]


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
    if not isinstance(policy, Policy):
        return False
    trained = policy.metadata.get(TASK, {})
    return (
        policy.keys == ROADMAP_KEYS
        and policy.critics
        and policy.action_space.shape == (number_of_actions(task),)
        and trained.get("catheter") == task.catheter
    )
