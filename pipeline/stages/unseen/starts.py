"""Starts beyond the ostium in every training anatomy, where the wire was laid instead of steered.

One file an anatomy, ``starts/<anatomy>.npz`` in the stage's folder, with an array of states for each target: the wire
laid along the planned way to some places before the target, and each of them drawn back a little, turning.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.jobs.worker import Report
from pipeline.store.atomic_files import write_arrays

if TYPE_CHECKING:
    from pipeline.stages.unseen.task import UnseenTask

STARTS = "starts"  # job and folder


@dataclass(frozen=True)
class StartsJob:
    """Starts to lay.

    Attributes:
        anatomies: seeds of the random arches.
        seed: of the turns while drawing back.
    """

    folder: Path
    task: UnseenTask
    anatomies: tuple[int, ...]
    seed: int


def lay_starts(job: StartsJob, report: Report) -> dict[str, Any]:
    """Lays the starts of the anatomies whose file is not there yet.

    Returns:
        How many anatomies there are, and how many states.
    """
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
    """The starts of some anatomies as an environment over them takes them.

    Args:
        anatomies: seeds of the environment's random arches.

    Returns:
        For each case that has some, states with the case's number last. Shapes (k, n + 1).
    """
    found = []
    for place, anatomy in enumerate(anatomies):
        with np.load(folder / f"{anatomy}.npz") as arrays:
            for number, target in enumerate(targets):
                if len(states := arrays[target]):
                    case = np.full((len(states), 1), place * len(targets) + number, float)
                    found.append(np.concatenate((states, case), axis=1))
    return found
