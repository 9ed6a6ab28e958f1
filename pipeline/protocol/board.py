"""The board: one policy file in the whole of a published task, as a row.

Rules: cases are fixed and belong to no training and no choice; the actions of an `enn.policy.Policy` are drawn, with
the episode's seed; those of other files are taken as they come. An episode is a success where the task says so.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.protocol.navigation import controller_of, steered
from pipeline.store.atomic_files import write_text
from pipeline.store.errors import ConfigurationError
from pipeline.store.provenance import hash_file, present_commit, software_versions, uncommitted_changes

if TYPE_CHECKING:
    from cathsim.environment import NavigateEnv
    from cathsim.many_anatomies import NavigateManyEnv

RULES = 1  # raised where figures of before can no longer be compared
_DUAL = "dualdevicenav"
_FIRST, _ARCHES = 60, 40  # of the test seeds of each type: the first 60 were looked at before
_TREES, _EACH = range(700_000, 700_050), 2  # of random trees: nothing is trained, chosen or looked at in them


@dataclass(frozen=True)
class Episode:
    """Where an episode is played: its labels, such as the name of the anatomy, and what `reset` is called with."""

    labels: dict[str, str]
    seed: int
    options: dict[str, Any]


@dataclass(frozen=True)
class Board:
    """A published task in which every policy plays the same episodes.

    Attributes:
        title: of the task, as in its table.
        make: the environment, from the names of observations, a catheter's name or None, and the side of images, px.
        episodes: all of them, in an order whose beginning is a fair part of the whole.
    """

    title: str
    make: Callable[..., NavigateEnv | NavigateManyEnv]
    episodes: Sequence[Episode]


def boards() -> dict[str, Board]:
    """The tasks by name."""
    from cathsim.anatomy.generator.variety_arch import ARCH_TYPES
    from cathsim.arch_variety import TEST_SEEDS, ArchVarietyEnv
    from cathsim.dual_device_nav import TEST_SEEDS as DUAL_SEEDS
    from cathsim.dual_device_nav import DualDeviceNavEnv, RandomTreesEnv

    arches = TEST_SEEDS[_FIRST : _FIRST + _ARCHES]

    def variety(observation: Any, catheter: str | None, side: int) -> ArchVarietyEnv:
        return ArchVarietyEnv(ARCH_TYPES, arches, observation=observation, catheter=catheter, image_size=side)

    def dual(observation: Any, catheter: str | None, side: int) -> DualDeviceNavEnv:
        return DualDeviceNavEnv(observation=observation, image_size=side)

    def trees(observation: Any, catheter: str | None, side: int) -> RandomTreesEnv:
        return RandomTreesEnv(_TREES, observation=observation, image_size=side)

    return {
        "arch_variety": Board("ArchVariety", variety, [
            Episode({"anatomy": f"{kind}_{arch}", "variation": kind}, _FIRST + k, {"case": place * len(arches) + k})
            for k, arch in enumerate(arches) for place, kind in enumerate(ARCH_TYPES)
        ]),
        "dual_device_nav": Board("DualDeviceNav", dual, [Episode({"anatomy": _DUAL}, seed, {}) for seed in DUAL_SEEDS]),
        "random_trees": Board("RandomTrees", trees, [
            Episode({"anatomy": f"random_tree_{tree}"}, _EACH * case + k, {"case": case})
            for k in range(_EACH) for case, tree in enumerate(_TREES)
        ]),
    }  # fmt: skip


def measure_row(
    file: Path, board: str, count: int | None = None, tell: Callable[[str, int, int], None] = lambda *_: None
) -> dict[str, Any]:
    """Plays a policy's episodes.

    Args:
        file: of a policy, as a training or `enn.export.export_onnx` writes it.
        board: of `boards`.
        count: episodes, the first ones, instead of all.
        tell: called with the board's name, how many episodes are done, and how many there are.

    Returns:
        The row: what was played, by which policy, `summary` with 95 % intervals, and each case.

    Raises:
        OSError, ValueError: no such board or file, or a policy of another observation or device.
    """
    from pipeline.protocol.run import summary

    require_policy_file(file)
    known = boards()
    if board not in known:
        raise ConfigurationError(f"there is no board {board!r}: choose from {', '.join(known)}")
    played = known[board].episodes[:count]
    policy, environment, bare = seated(file, known[board])
    cases = []
    for number, episode in enumerate(played):
        outcome = _play(policy, environment, episode)
        branch = bare.phantom.target(bare.task.target).branch
        cases.append({**episode.labels, "seed": episode.seed, "target": branch, **outcome})
        tell(board, number + 1, len(played))
    environment.close()
    return {
        "board": board,
        "rules": RULES,
        "whole": len(played) == len(known[board].episodes),
        "policy": {"file": file.name, "sha256": hash_file(file), "sees": list(policy.keys), **_catheter(policy)},
        "made_by": {"commit": present_commit(), "changes": uncommitted_changes()},
        "versions": software_versions(),
        "summary": summary(cases),
        "cases": cases,
    }


def write_row(row: dict[str, Any], path: Path) -> str:
    """Writes a row's file, whole; the line that the page has for it."""
    from pipeline.protocol.run import result_text

    write_text(path, result_text(row))
    summary, name = row["summary"], row["policy"]["file"]
    share, force = summary["success_pct"], summary["force_max_n"]
    reached = sum(case["success"] for case in row["cases"])
    return (
        f"| {name} | {reached} of {summary['cases']} | {share['mean']:g} % ({share['low']:g} to {share['high']:g}) | "
        f"{force:.2f} N |"
    )


def require_policy_file(file: Path) -> None:
    """Refuses what is no policy's file, before anything heavy is imported."""
    if not file.is_file():
        raise ConfigurationError(f"there is no policy {file}")
    if file.suffix == ".zip":
        raise ConfigurationError(f"{file}: a zip of stable-baselines3 may run code when it is read: export it to ONNX")


def read_any_policy(file: Path) -> Any:
    """A policy of any kind that plays: of ours, or ONNX; with `keys` and `controller`.

    Raises:
        OSError, ValueError: there is no such file, or it is of no such kind.
    """
    require_policy_file(file)
    from enn.export import OnnxPolicy
    from enn.shipped import read_policy

    return OnnxPolicy(file) if file.suffix == ".onnx" else read_policy(file)


def seated(file: Path, board: Board) -> tuple[Any, Any, Any]:
    """A policy, the environment of its observations and devices, and the same without images.

    Raises:
        OSError, ValueError: as of `read_any_policy`; or what the policy sees or moves is not what the task has.
    """
    from cathsim.observations.xray import XrayEnvironment
    from enn.imitation.images.policy import ImagePolicy
    from pipeline.task import task_in_random_arches

    os.environ.setdefault("OMP_NUM_THREADS", "1")
    policy, side = read_any_policy(file), task_in_random_arches().image_size_px
    by_images = isinstance(policy, ImagePolicy)
    seen = ("goal_image",) if by_images else policy.keys or "tracking"
    bare = board.make(seen, _catheter(policy)["catheter"], side)
    environment: Any = XrayEnvironment(bare, side, **policy.imaging) if by_images else bare
    moved = getattr(getattr(policy, "action_space", None), "shape", environment.action_space.shape)
    if moved != environment.action_space.shape:
        raise ConfigurationError(
            f"{file} gives actions of shape {moved}, {board.title} takes {environment.action_space.shape}: translation "
            "and rotation of each device"
        )
    return policy, environment, bare


def _catheter(policy: Any) -> dict[str, str | None]:
    from pipeline.task import TASK

    return {"catheter": getattr(policy, "metadata", {}).get(TASK, {}).get("catheter")}


def _play(policy: Any, environment: Any, episode: Episode) -> dict[str, Any]:
    controller = controller_of(policy, episode.seed)
    controller.reset()
    return steered(environment, controller, seed=episode.seed, options=episode.options)[0]
