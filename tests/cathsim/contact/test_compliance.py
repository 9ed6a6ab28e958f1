"""A wall of a given stiffness: forces at its contacts, what is refused, and that a continuation is the same."""

from __future__ import annotations

import dataclasses
import pickle

import numpy as np
import pytest

from cathsim.anatomy import Phantom, load_phantom
from cathsim.contact.compliance import stiffest_wall
from cathsim.devices.pair import DevicePair
from cathsim.devices.shelf import load_catheter
from cathsim.devices.simulation import DualSimulation
from cathsim.guidewire import Guidewire, load_guidewire
from cathsim.presets import ACCURACY
from cathsim.simulation import Simulation


@pytest.fixture(scope="module")
def phantom() -> Phantom:
    return load_phantom("type_1")


def pushed(phantom: Phantom, stiffness: float, accuracy: str) -> Simulation:
    """A wire pushed against the arch and left to rest for 4 s."""
    simulation = Simulation(phantom, Guidewire(), ACCURACY[accuracy], wall_stiffness=stiffness)
    for step in range(90):
        simulation.advance(0.002, 0.1 if step % 10 == 0 else 0.0)
    for _ in range(40):
        simulation.advance(0.0, 0.0)
    return simulation


def contact_stiffnesses(simulation: Simulation) -> np.ndarray:
    """Normal force over depth at every contact with the wall above 1 mN, N/mm."""
    data, wall = simulation.data, simulation.model.geom("vessel").id
    found = []
    for contact in data.contact:
        if contact.geom[1] == wall and contact.efc_address >= 0 and data.efc_force[contact.efc_address] > 1e-3:
            found.append(data.efc_force[contact.efc_address] / -contact.dist / 1000.0)
    return np.array(found)


@pytest.mark.parametrize(("stiffness", "accuracy"), [(0.3, "fast"), (1.0, "accurate")])
def test_force_at_rest_is_stiffness_times_depth(phantom: Phantom, stiffness: float, accuracy: str) -> None:
    measured = contact_stiffnesses(pushed(phantom, stiffness, accuracy))
    assert len(measured) >= 2
    assert np.median(measured) == pytest.approx(stiffness, rel=0.01)


def test_a_softer_wall_is_deeper_and_the_resultant_the_same(phantom: Phantom) -> None:
    soft, stiff = (pushed(phantom, stiffness, "accurate") for stiffness in (0.2, 1.0))
    depths = [-min(contact.dist for contact in one.data.contact) for one in (soft, stiff)]
    assert depths[0] > 2 * depths[1]
    forces = [np.linalg.norm(one.summary.mean_force) for one in (soft, stiff)]
    assert forces[0] == pytest.approx(forces[1], rel=0.25)


def test_the_usual_wall_is_left_as_it_is(phantom: Phantom) -> None:
    usual = Simulation(phantom, Guidewire(), ACCURACY["fast"])
    before = usual.model.geom_solref.copy()
    compliant = Simulation(phantom, Guidewire(), ACCURACY["fast"], wall_stiffness=0.5)
    assert np.array_equal(usual.model.geom_solref, before)
    assert not np.array_equal(compliant.model.geom_solref, before)


def test_a_continuation_is_the_same(phantom: Phantom) -> None:
    simulation = Simulation(phantom, Guidewire(), ACCURACY["fast"], wall_stiffness=0.5)
    for _ in range(60):
        simulation.advance(0.002, 0.05)
    other = Simulation(phantom, Guidewire(), ACCURACY["fast"], wall_stiffness=0.5)
    other.restore(simulation.state())
    copy = pickle.loads(pickle.dumps(simulation))
    assert copy.wall_stiffness == 0.5
    for one in (simulation, other, copy):
        for _ in range(10):
            one.advance(0.002, 0.1)
    assert np.array_equal(simulation.data.qpos, other.data.qpos)
    assert np.array_equal(simulation.data.qpos, copy.data.qpos)


@pytest.mark.parametrize(
    ("stiffness", "accuracy", "message"),
    [
        (5.0, "accurate", "resolves walls of at most 1 N/mm, got wall_stiffness 5: take accuracy='reference'"),
        (0.0, "reference", "wall_stiffness must lie in 0.1 to 100 N/mm, got 0"),
        (float("nan"), "reference", "wall_stiffness must be a finite number"),
    ],
)
def test_a_wall_that_cannot_be_is_refused(phantom: Phantom, stiffness: float, accuracy: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Simulation(phantom, Guidewire(), ACCURACY[accuracy], wall_stiffness=stiffness)


def test_stiffest_wall_follows_the_timestep() -> None:
    assert stiffest_wall(ACCURACY["reference"]) == pytest.approx(10.0)
    assert stiffest_wall(ACCURACY["fast"]) == pytest.approx(0.5)


def test_a_catheter_over_the_wire_meets_the_same_wall(phantom: Phantom) -> None:
    pair = DevicePair(load_guidewire("default"), load_catheter("vertebral"))
    simulation = DualSimulation(phantom, pair, ACCURACY["accurate"], wall_stiffness=0.2)
    for step in range(90):
        simulation.advance(0.002, 0.1 if step % 10 == 0 else 0.0, catheter=(0.0018, 0.0))
    for _ in range(60):
        simulation.advance(0.0, 0.0)
    measured = contact_stiffnesses(simulation)
    assert len(measured) >= 2
    assert np.median(measured) == pytest.approx(0.2, rel=0.01)


def test_repeated_substeps_of_two_devices_have_their_own_timestep(phantom: Phantom) -> None:
    """Their models share what contacts are made with: every step leaves it as its own timestep needs it."""
    pair = DevicePair(load_guidewire("default"), load_catheter("vertebral"))
    numerics = dataclasses.replace(ACCURACY["accurate"], tolerance=0.0, rise=0.0)  # repeats whatever goes deeper
    simulation = DualSimulation(phantom, pair, numerics, wall_stiffness=0.5)
    refined, seen = 0, set()
    for _ in range(90):
        simulation.advance(0.002, 0.0, catheter=(0.0018, 0.0))
        refined += simulation.summary.refined
        first = simulation.model.geom("wire0").id
        seen.add(round(float(np.sqrt(-0.9 / simulation.model.geom_solref[first, 0])), 9))
    assert refined > 10
    assert len(seen) > 1
    own = simulation.numerics
    assert seen <= {round(own.timestep / own.refinement**power, 9) for power in range(3)}
