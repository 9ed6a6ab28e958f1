"""Starts beyond the ostium in every training anatomy, where the wire was laid instead of steered.

One file an anatomy, ``starts/<anatomy>.npz`` in the stage's folder, with an array of states for each target: the wire
laid along the planned way to some places before the target, and each of them drawn back a little, turning.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.jobs.worker import Report
from pipeline.store.atomic_files import atomic_path

if TYPE_CHECKING:
    from cathsim import NavigateEnv
    from pipeline.stages.unseen.task import UnseenTask

SHORT_OF_END = (0.012, 0.018, 0.025, 0.032, 0.040, 0.050)  # m from the tip to the target along the planned way
WITHDRAWALS, WITHDRAWAL_STEPS = 3, 4  # states kept while drawing back, steps between them
MOST_FORCE = 0.5  # N: with more the wire lies jammed

_LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True)
class StartsJob:
    """Starts to lay.

    Attributes:
        folder: of all starts.
        task: of the episodes.
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
                arrays[target] = laid_states(environment.current, generator)
            path.parent.mkdir(parents=True, exist_ok=True)
            with atomic_path(path) as temporary, temporary.open("wb") as stream:
                np.savez(stream, **arrays)  # type: ignore[arg-type]
        with np.load(path) as kept:
            states += sum(len(kept[target]) for target in job.task.targets)
    if environment is not None:
        environment.close()
    return {"anatomies": len(job.anatomies), "states": states}


def laid_states(environment: NavigateEnv, generator: np.random.Generator) -> np.ndarray:
    """States with the wire laid towards the target, and drawn back from there.

    Args:
        environment: with the anatomy and the target; its simulation is used.
        generator: of the turns while drawing back.

    Returns:
        Shape (k, n); none where the wire is too short, or there is no way with a clearance.
    """
    from cathsim.planning.path import UnreachableError
    from cathsim.wire_placement import place_wire, plan_way

    simulation, target = environment.simulation, environment.task.target
    states: list[np.ndarray] = []
    try:
        way = plan_way(simulation, environment.phantom.target(target).position)
    except UnreachableError:
        _LOGGER.info("no way with a clearance to %s of %s: no starts there", target, environment.phantom.name)
        return np.empty((0, len(simulation.state())))
    for short in SHORT_OF_END:
        try:
            place_wire(simulation, way, short)
        except ValueError:  # the wire is too short for this one
            continue
        kept = [simulation.state()] if _at_rest(environment) else []
        for _ in range(WITHDRAWALS if kept else 0):
            for _ in range(WITHDRAWAL_STEPS):
                simulation.advance(-0.002, float(generator.uniform(-0.26, 0.26)))
            if _at_rest(environment):
                kept.append(simulation.state())
        states += kept
    return np.array(states) if states else np.empty((0, len(simulation.state())))


def _at_rest(environment: NavigateEnv) -> bool:
    """Whether a start there makes sense: the simulation holds, nothing jams, and the target is still to be reached."""
    simulation = environment.simulation
    near = np.linalg.norm(simulation.tip - environment.phantom.target(environment.task.target).position)
    return (
        simulation.valid
        and simulation.summary.force_max < MOST_FORCE
        and bool(near > environment.task.success_radius)
        and bool(np.isfinite(simulation.state()).all())
    )


def read_starts(folder: Path, anatomies: Sequence[int], targets: Sequence[str]) -> list[np.ndarray]:
    """The starts of some anatomies as an environment over them takes them.

    Args:
        folder: of all starts.
        anatomies: seeds of the environment's random arches.
        targets: of the environment.

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
