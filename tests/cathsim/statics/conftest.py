"""A wire at rest in an arch, shared by the tests of forces from shape."""

from typing import NamedTuple

import numpy as np
import pytest

from cathsim.anatomy import Phantom, load_phantom
from cathsim.guidewire import Guidewire
from cathsim.presets import ACCURACY
from cathsim.simulation import Simulation
from cathsim.statics import inserted_curve
from cathsim.statics.observed_curve import observed_curve
from cathsim.statics.resting_contacts import RestingContacts, resting_contacts


class Resting(NamedTuple):
    """A simulated wire at rest, and what an estimate of its contacts is to find."""

    phantom: Phantom
    wire: Guidewire
    simulation: Simulation
    curve: np.ndarray
    truth: RestingContacts


@pytest.fixture(scope="session")
def resting() -> Resting:
    phantom, wire = load_phantom("type_1"), Guidewire()
    simulation = Simulation(phantom, wire, ACCURACY["accurate"])
    simulation.reset(0.0, 0.7)
    for _ in range(105):
        simulation.advance(0.002, 0.02)
    for _ in range(20):
        simulation.advance(0.0, 0.0)
    curve = inserted_curve(simulation)
    observed = observed_curve(curve, phantom, "descending", simulation.max_insertion)
    return Resting(phantom, wire, simulation, curve, resting_contacts(simulation, observed))
