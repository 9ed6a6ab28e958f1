"""The native solver of contacts: it finds what MuJoCo's own finds when that goes on to rounding."""

from __future__ import annotations

import copy
import dataclasses
from typing import Any

import numpy as np
import pytest

from cathsim.anatomy import Phantom, load_phantom
from cathsim.contact.breathing import Breathing
from cathsim.devices.active_chain import ActiveChain
from cathsim.devices.pair import DevicePair
from cathsim.devices.shelf import load_catheter
from cathsim.devices.simulation import DualSimulation
from cathsim.guidewire import Guidewire, load_guidewire
from cathsim.presets import ACCURACY
from cathsim.simulation import Simulation

TIGHT = 1e-16  # of MuJoCo's solver, whose usual tolerance here is 1e-6
STEPS = 110


@pytest.fixture
def phantom() -> Phantom:
    """One of its own for each test, so that models are shared with no other."""
    return copy.copy(load_phantom("type_1"))


def advance(simulation: Simulation, step: int) -> None:
    turn = 0.25 if step % 7 < 3 else -0.1
    if isinstance(simulation, DualSimulation):
        simulation.advance(0.002, turn, catheter=(0.0019, 0.5 * turn))
    else:
        simulation.advance(0.002, turn)


def left_to_mujoco(chain: ActiveChain) -> ActiveChain:
    chain.struct.solver_rows = 0
    chain.model.opt.tolerance, chain.model.opt.iterations = TIGHT, 500
    return chain


class WireOfMujoco(Simulation):
    def _make_chain(self, wire: Guidewire) -> ActiveChain:
        return left_to_mujoco(super()._make_chain(wire))


class DualOfMujoco(DualSimulation):
    def _make_chain(self, wire: Guidewire) -> ActiveChain:
        return left_to_mujoco(super()._make_chain(wire))


def own_and_mujocos(phantom: Phantom, accuracy: str, devices: str, **settings: Any) -> tuple[Simulation, Simulation]:
    numerics = dataclasses.replace(ACCURACY[accuracy], refinement=1, catheter_refinement=1)
    wire = load_guidewire("default")
    if devices == "wire":
        return Simulation(phantom, wire, numerics, **settings), WireOfMujoco(phantom, wire, numerics, **settings)
    pair = DevicePair(wire, load_catheter(devices))
    return DualSimulation(phantom, pair, numerics, **settings), DualOfMujoco(phantom, pair, numerics, **settings)


@pytest.mark.parametrize(
    ("accuracy", "devices", "settings"),
    [
        ("fast", "wire", {}),
        ("accurate", "wire", {"breathing": Breathing(period=2.0), "wall_stiffness": 0.5}),
        ("accurate", "simmons2", {"breathing": Breathing(period=2.0)}),
    ],
)
def test_motion_and_forces_are_mujocos(phantom: Phantom, accuracy: str, devices: str, settings: dict[str, Any]) -> None:
    """Each control step is made twice from the same state."""
    own, mujocos = own_and_mujocos(phantom, accuracy, devices, **settings)
    rows, iterations, apart, force = [], [], [], []
    for step in range(STEPS):
        mujocos.restore(own.state())
        own.restore(own.state())
        for one in (own, mujocos):
            advance(one, step)
        rows.append(own.data.nefc)
        iterations.append(int(own.data.solver_niter[0]))
        apart.append(float(np.abs(own.wire_points() - mujocos.wire_points()).max()))
        size = max(float(np.linalg.norm(own.force())), 0.01)
        force.append(float(np.linalg.norm(own.force() - mujocos.force())) / size)
    assert max(rows) >= 9
    assert max(iterations) >= 2
    assert max(apart) < 1e-8  # m, of 2 mm
    assert max(force) < 1e-5
