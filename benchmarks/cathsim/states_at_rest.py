"""Devices at rest in a vessel after random pushes and turns, with their true contact forces."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy import Phantom
from cathsim.devices.pair import DevicePair
from cathsim.devices.shelf import load_catheter
from cathsim.devices.simulation import DualSimulation
from cathsim.guidewire import Guidewire
from cathsim.presets import ACCURACY
from cathsim.simulation import Simulation
from cathsim.statics import inserted_curve
from cathsim.statics.observed_curve import observed_curve
from cathsim.statics.resting_contacts import RestingContacts, resting_contacts

Device = Guidewire | DevicePair

LEAST_RESULTANT = 0.03  # N: relative errors of less mean little
WIRE = Guidewire().scaled(0.36)  # the default one, long enough for every branch
PAIR = DevicePair(WIRE, load_catheter("vertebral"))
REST = 20  # control steps before the truth is read
PUSH, TURN = 0.002, 0.26  # of a full control step, m and rad
MOST_LEAD = 0.06  # of the wire before the catheter, m
ANOTHER_LEAD = 0.02  # probability of a step that another lead is wanted from there on

Array = NDArray[np.float64]


@dataclass(frozen=True)
class State:
    """A device at rest."""

    phantom: Phantom
    curve: Array  # from the entry to the tip, m. Shape (n, 3).
    nodes: Array  # of the wire, from the tip, what lies in the sheath included, m. Shape (m, 3).
    insertion: float  # m
    rotation: float  # rad
    truth: RestingContacts
    catheter: tuple[float, float] | None = None  # insertion (m) and rotation (rad) of a catheter over the wire

    @property
    def forces(self) -> dict[str, float]:
        """The true numbers, N."""
        resultant = float(np.linalg.norm(self.truth.resultant))
        return {"resultant": resultant, "normal_sum": self.truth.normal_sum, "largest": self.truth.largest}


def states_at_rest(phantom: Phantom, count: int, seed: int, device: Device = WIRE) -> Iterator[State]:
    """Devices at rest after random pushes and turns, with a resultant of 0.03 N at least."""
    generator = np.random.default_rng(seed)
    moved = _Pair(phantom, device, generator) if isinstance(device, DevicePair) else _Wire(phantom, device)
    simulation = moved.simulation
    moved.begin(generator.uniform(-np.pi, np.pi))
    while count:
        goal, turn = generator.uniform(0.10, 0.30), generator.uniform(-0.5, 0.5)
        for _ in range(int((simulation.insertion - goal) / PUSH)):
            moved.move(-1.0, 0.0)
        for _ in range(250):
            if simulation.insertion > goal - 0.001:
                break
            moved.move(generator.normal(0.7, 0.4), turn + generator.normal(0.0, 0.35))
        lean, turn = generator.uniform(-1, 1, 2)
        for _ in range(generator.integers(5, 20)):
            moved.move(lean + generator.normal(0.0, 0.4), turn + generator.normal(0.0, 0.7))
        for _ in range(REST):
            moved.move(0.0, 0.0)
        curve = inserted_curve(simulation)
        truth = resting_contacts(simulation, observed_curve(curve, phantom, "descending", simulation.max_insertion))
        if simulation.valid and np.linalg.norm(truth.resultant) >= LEAST_RESULTANT:
            count -= 1
            nodes = simulation.wire_points()
            yield State(phantom, curve, nodes, simulation.insertion, simulation.rotation, truth, moved.catheter())


class _Wire:
    """A wire that is moved by shares of a full step."""

    def __init__(self, phantom: Phantom, device: Guidewire) -> None:
        self.simulation = Simulation(phantom, device, ACCURACY["accurate"])

    def begin(self, rotation: float) -> None:
        self.simulation.reset(0.0, rotation)

    def move(self, push: float, turn: float) -> None:
        self.simulation.advance(PUSH * float(np.clip(push, -1, 1)), TURN * float(np.clip(turn, -1, 1)))

    def catheter(self) -> None:
        return None


class _Pair:
    """A wire in a catheter that follows it, 0 to `MOST_LEAD` behind, and is turned by its own."""

    def __init__(self, phantom: Phantom, device: DevicePair, generator: np.random.Generator) -> None:
        self.simulation, self._generator = DualSimulation(phantom, device, ACCURACY["accurate"]), generator
        self._wanted = 0.0  # lead, m

    def begin(self, rotation: float) -> None:
        self.simulation.reset(0.0, rotation, catheter=(0.0, self._generator.uniform(-np.pi, np.pi)))

    def move(self, push: float, turn: float) -> None:
        along, around = PUSH * float(np.clip(push, -1, 1)), TURN * float(np.clip(turn, -1, 1))
        if along == around == 0.0:
            self.simulation.advance(0.0, 0.0)
            return
        if self._generator.random() < ANOTHER_LEAD:
            self._wanted = self._generator.uniform(0.0, MOST_LEAD)
        follows = float(np.clip(self.simulation.device_lead + along - self._wanted, -PUSH, PUSH))
        turned = around * float(np.clip(self._generator.normal(0.5, 0.5), -1, 1))
        self.simulation.advance(along, around, catheter=(follows, turned))

    def catheter(self) -> tuple[float, float]:
        return self.simulation.catheter_place()
