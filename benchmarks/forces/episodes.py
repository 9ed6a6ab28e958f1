"""Episodes in Type I by device, friction, operator and target, with the forces of every control step."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.forces.operators import OPERATORS, WIRE, Operator
from cathsim import NavigateEnv, load_guidewire
from cathsim.devices.shelf import load_catheter
from cathsim.metrics.load_cell import MINI40, step_forces
from cathsim.simulation import CONTROL_STEP

Array = NDArray[np.float64]

PHANTOM, TARGETS = "type_1", ("bca", "lcca")
MOST_STEPS = 300
USUAL_FRICTION = 0.06


@dataclass(frozen=True)
class Case:
    """What is done in an episode: "wire" or a catheter over the wire, both of one friction; operator, target, seed."""

    device: str
    friction: float
    operator: str
    target: str
    seed: int
    blood: str | None = None  # "steady" or "pulsatile": its drag on the devices, and on the load cell

    def environment(self, observation: str | Sequence[str] = "tip", **arguments: Any) -> NavigateEnv:
        """The environment, with further arguments of its own."""
        wire = load_guidewire("default", friction=self.friction)
        catheter = None if self.device == WIRE else load_catheter(self.device, friction=self.friction)
        arguments = {"wire": wire, "catheter": catheter, "max_steps": MOST_STEPS, "blood": self.blood, **arguments}
        return NavigateEnv(PHANTOM, self.target, observation=observation, **arguments)

    def generator(self) -> np.random.Generator:
        """Of the operator's draws."""
        return np.random.default_rng((self.seed, TARGETS.index(self.target)))


@dataclass(frozen=True)
class Episode:
    """Forces of one episode, a row a control step.

    Attributes:
        loads: mean force on the vessel, N, world frame. Shape (T, 3).
        sheath: mean force on the sheath, N. Shape (T, 3).
        sums, largest, resultants: N; the last is the largest resultant of a step. Shape (T,).
        motions: of the feeders, in shares of a full step. Shape (T, 2 or 4).
    """

    case: Case
    success: bool
    loads: Array
    sheath: Array
    sums: Array
    largest: Array
    resultants: Array
    motions: Array

    def quantities(self) -> dict[str, Array]:
        """The compared quantities, N. Shape (T,) each."""
        return {"load_cell": self.reading("SI-20-1"), "sum": self.sums, "largest": self.largest}

    def reading(self, calibration: str, *, sheath: bool = False, **changes: Any) -> Array:
        """Magnitudes of a load cell's readings, N. Shape (T,)."""
        cell = dataclasses.replace(MINI40[calibration], **changes)
        loads = self.loads + self.sheath if sheath else self.loads
        readings = cell.read(loads, interval=CONTROL_STEP, generator=np.random.default_rng(self.case.seed))
        return np.linalg.norm(readings, axis=1)


def run_episode(case: Case, operator: Operator, observation: str | Sequence[str] = "tip") -> Episode:
    """Steers one episode to within 8 mm of the target, at most `MOST_STEPS`."""
    environment = case.environment(observation)
    act = operator(environment, case.generator())
    seen, info = environment.reset(seed=case.seed)
    rows, motions, resultants, ended = [], [], [], False
    while not ended:
        motion = np.asarray(act(seen), np.float64)
        seen, _, terminated, truncated, info = environment.step(motion)
        ended = terminated or truncated
        if not info["invalid"]:
            motions.append(motion)
            rows.append(step_forces(environment.simulation))
            resultants.append(info["force"])
    environment.close()
    return Episode(
        case,
        bool(info["success"]),
        loads=np.array([row.load for row in rows]),
        sheath=np.array([row.sheath for row in rows]),
        sums=np.array([row.magnitude_sum for row in rows]),
        largest=np.array([row.largest_contact for row in rows]),
        resultants=np.array(resultants),
        motions=np.array(motions),
    )


def expert_episodes(device: str, seeds: int) -> list[Episode]:
    """The sampling expert's episodes to all targets at the usual friction."""
    cases = [Case(device, USUAL_FRICTION, "expert", target, seed) for target in TARGETS for seed in range(seeds)]
    return [run_episode(case, OPERATORS["expert"]) for case in cases]
