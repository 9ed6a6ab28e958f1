"""Demonstrations of the sampling expert in training anatomies, and starts beyond the ostium, where a wire was laid.

A demonstration is a file, ``demonstrations/<target>_<anatomy>.npz`` in the stage's folder, with everything that an
`enn.trajectory.Trajectory` holds; of one that fails it says only that, so that it is not tried again. Starts are a file
an anatomy, ``starts/<anatomy>.npz``, with an array of states for each target: the wire laid along the planned way to
some places before the target, and each of them drawn back a little, turning.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.jobs.worker import Report
from pipeline.seeds import arch_demonstration_seed
from pipeline.stages.unseen.task import ROADMAP_KEYS
from pipeline.store.atomic_files import write_arrays

if TYPE_CHECKING:
    from enn.trajectory import Trajectory
    from pipeline.stages.unseen.task import UnseenTask


ARRIVED = "terminated"  # name in the file: whether the target was reached


def demonstration_arrays(shown: Trajectory) -> dict[str, Any]:
    """The arrays of an episode by their names in the file; of one that did not arrive, only that."""
    if not shown.terminated:
        return {ARRIVED: np.array(False)}
    return {
        **shown.observations,
        "actions": shown.actions,
        "rewards": shown.rewards,
        ARRIVED: np.array(True),
        "forces": shown.forces,
        "tips": shown.tips,
        "states": shown.simulation_states,
    }


def arrived(path: Path) -> bool:
    """Whether the episode of a file reached its target."""
    with np.load(path) as arrays:
        return bool(arrays[ARRIVED])


def read_demonstration(path: Path, keys: Sequence[str], **metadata: Any) -> Trajectory | None:
    """The episode of a file with observations `keys` and further metadata; None: it did not reach its target."""
    from enn.trajectory import Trajectory

    with np.load(path) as arrays:
        if not arrays[ARRIVED]:
            return None
        return Trajectory(
            {key: arrays[key] for key in keys},
            arrays["actions"],
            arrays["rewards"],
            True,
            arrays["forces"],
            arrays["tips"],
            arrays["states"],
            {"file": str(path), **metadata},
        )


DEMONSTRATIONS = "demonstrations"  # job and folder


@dataclass(frozen=True)
class DemonstrationsJob:
    """Demonstrations to make."""

    folder: Path
    task: UnseenTask
    anatomies: tuple[int, ...]  # seeds of all random arches trained on, so that states know their case
    shown: tuple[int, ...]  # those of them with a demonstration each
    target: str
    hold: int  # steps for which the expert holds an action: those of a decision of the policy
    seed: int


def record_demonstrations(job: DemonstrationsJob, report: Report) -> dict[str, Any]:
    """Plays the episodes whose file is not there yet: how many there are, and how many reached their target."""
    from cathsim.planning.demonstration import demonstrate

    environment = job.task.training_environment(job.anatomies, ROADMAP_KEYS)
    target = job.task.targets.index(job.target)
    reached = 0
    for done, seed in enumerate(job.shown):
        text = f"{job.target} of arch {seed}, {reached}/{done} reached"
        path = job.folder / f"{job.target}_{seed}.npz"
        if not path.is_file():
            case = environment.case_of(job.anatomies.index(seed), target)
            tick = partial(report, done / len(job.shown), text)
            seed_of_start = arch_demonstration_seed(job.seed)
            write_arrays(
                path, demonstrate(environment, case, ROADMAP_KEYS, hold=job.hold, seed=seed_of_start, tick=tick)
            )
        reached += arrived(path)
    environment.close()
    return {"shown": len(job.shown), "reached": reached}


def read_demonstrations(folder: Path, anatomies: Sequence[int]) -> list[Trajectory]:
    """The demonstrations that reached their target, in random arches of these seeds."""
    found = []
    for path in sorted(folder.glob("*.npz")):
        target, anatomy = path.stem.split("_")
        if int(anatomy) in anatomies:
            shown = read_demonstration(path, ROADMAP_KEYS, target=target, anatomy=int(anatomy))
            found += [] if shown is None else [shown]
    return found


STARTS = "starts"  # job and folder


@dataclass(frozen=True)
class StartsJob:
    """Starts to lay."""

    folder: Path
    task: UnseenTask
    anatomies: tuple[int, ...]  # seeds of the random arches
    seed: int  # of the turns while drawing back


def lay_starts(job: StartsJob, report: Report) -> dict[str, Any]:
    """Lays the starts of the anatomies whose file is not there yet: how many anatomies, and how many states."""
    from cathsim.devices.wire_placement import laid_starts

    states = 0
    environment = None
    for place, anatomy in enumerate(job.anatomies):
        report(place / len(job.anatomies), f"starts in arch {anatomy}")
        path = job.folder / f"{anatomy}.npz"
        if not path.is_file():
            environment = environment or job.task.training_environment(job.anatomies, ("tip",))
            generator = np.random.default_rng((job.seed, anatomy))
            arrays = {}
            for number, target in enumerate(job.task.targets):
                environment.reset(seed=0, options={"case": environment.case_of(place, number)})
                arrays[target] = laid_starts(environment.current, generator)
            write_arrays(path, arrays)
        with np.load(path) as kept:
            states += sum(len(kept[target]) for target in job.task.targets)
    if environment is not None:
        environment.close()
    return {"anatomies": len(job.anatomies), "states": states}


def read_starts(folder: Path, anatomies: Sequence[int], targets: Sequence[str]) -> list[np.ndarray]:
    """Starts for an environment over random arches of these seeds: a case each, its number last. Shapes (k, n + 1)."""
    found = []
    for place, anatomy in enumerate(anatomies):
        with np.load(folder / f"{anatomy}.npz") as arrays:
            for number, target in enumerate(targets):
                if len(states := arrays[target]):
                    case = np.full((len(states), 1), place * len(targets) + number, float)
                    found.append(np.concatenate((states, case), axis=1))
    return found
