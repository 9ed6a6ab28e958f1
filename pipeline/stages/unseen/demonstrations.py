"""Demonstrations of the sampling expert in some of the training anatomies.

One file a demonstration, ``demonstrations/<target>_<anatomy>.npz`` in the stage's folder, with everything that an
`enn.trajectory.Trajectory` holds. A demonstration that fails is kept too, without a use, so that it is not tried again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.jobs.worker import Report
from pipeline.recording.demonstration_files import arrived, read_demonstration
from pipeline.seeds import arch_demonstration_seed
from pipeline.stages.unseen.task import ROADMAP_KEYS
from pipeline.store.atomic_files import write_arrays

if TYPE_CHECKING:
    from enn.trajectory import Trajectory
    from pipeline.stages.unseen.task import UnseenTask

DEMONSTRATIONS = "demonstrations"  # job and folder


@dataclass(frozen=True)
class DemonstrationsJob:
    """Demonstrations to make.

    Attributes:
        anatomies: seeds of all random arches trained on, so that states know their case.
        shown: those of them with a demonstration each.
        hold: steps for which the expert holds an action: those of a decision of the policy.
    """

    folder: Path
    task: UnseenTask
    anatomies: tuple[int, ...]
    shown: tuple[int, ...]
    target: str
    hold: int
    seed: int


def record_demonstrations(job: DemonstrationsJob, report: Report) -> dict[str, Any]:
    """Plays the episodes whose file is not there yet.

    Returns:
        How many were played, and how many of them reached their target.
    """
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
    """The demonstrations that reached their target, in some anatomies.

    Args:
        anatomies: seeds of the random arches wanted.
    """
    found = []
    for path in sorted(folder.glob("*.npz")):
        target, anatomy = path.stem.split("_")
        if int(anatomy) in anatomies:
            shown = read_demonstration(path, ROADMAP_KEYS, target=target, anatomy=int(anatomy))
            found += [] if shown is None else [shown]
    return found
