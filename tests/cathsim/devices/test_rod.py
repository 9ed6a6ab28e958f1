"""The composite rod of wire and catheter: links, masses, stiffness."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad

from cathsim.anatomy import load_phantom
from cathsim.devices.catheter import Catheter
from cathsim.devices.pair import DevicePair
from cathsim.devices.shelf import load_catheter
from cathsim.devices.simulation import DualSimulation
from cathsim.guidewire import LINK_NAME, Guidewire, load_guidewire
from cathsim.presets import ACCURACY

NUMERICS = ACCURACY["accurate"]
WIRE = load_guidewire("default", friction=0.04, relaxation=0.05)
# tapers lie across links and joints at every lead; friction and relaxation differ from the wire's
CATHETER = Catheter(taper=(0.011, 0.043), friction=0.17, relaxation=0.2, shape=((0.0, 0.012, 0.7, 0.0),))
# of the wire before the catheter, m: at a link's end, within links of each length, and the wire drawn back
LEADS = (0.0, 0.0135, 0.024, 0.05, 0.131, -0.021, -0.1)


@pytest.fixture(scope="module")
def simulation() -> DualSimulation:
    return DualSimulation(load_phantom("type_1"), DevicePair(WIRE, CATHETER), NUMERICS)


@pytest.fixture(params=LEADS)
def lead(request: pytest.FixtureRequest, simulation: DualSimulation) -> float:
    simulation.reset(0.14 + min(request.param, 0.0), catheter=(0.14 - max(request.param, 0.0), 0.0))
    assert simulation.device_lead == pytest.approx(request.param)
    return float(request.param)


def links(simulation: DualSimulation) -> NDArray[np.float64]:
    """Both ends of the chain's present links, as distances from its end, m. Shape (links, 2)."""
    lengths = np.array(simulation.wire.links)[-simulation.active_links :]
    from_end = np.concatenate((np.cumsum(lengths[::-1])[::-1], [0.0]))
    return np.column_stack((from_end[1:], from_end[:-1]))


def lengths_within(simulation: DualSimulation, lead: float) -> dict[str, NDArray[np.float64]]:
    """Length of each device within each link, m."""
    low, high = links(simulation).T
    backs = {"wire": max(-lead, 0.0), "catheter": max(lead, 0.0)}
    return {name: np.clip(high - np.maximum(low, back), 0.0, None) for name, back in backs.items()}


def of_links(simulation: DualSimulation) -> tuple[slice, slice]:
    """Where the chain's geoms and bodies stand in the model."""
    first, count = simulation.model.geom(LINK_NAME.format(0)).id, simulation.active_links
    body = int(simulation.model.geom_bodyid[first])
    return slice(first, first + count), slice(body, body + count)


def area(device: Guidewire | Catheter) -> float:
    return np.pi / 4 * (device.diameter if isinstance(device, Guidewire) else device.outer_diameter) ** 2


def test_mass_is_that_of_both_devices(simulation: DualSimulation, lead: float) -> None:
    _, bodies = of_links(simulation)
    within = lengths_within(simulation, lead)
    masses = {
        name: NUMERICS.mass_scale * device.density * area(device) * within[name]
        for name, device in (("wire", WIRE), ("catheter", CATHETER))
    }
    total = masses["wire"] + masses["catheter"]
    model = simulation.model
    assert np.allclose(model.body_mass[bodies], total, rtol=1e-12)
    assert np.allclose(model.body_subtreemass[bodies], np.cumsum(total[::-1])[::-1], rtol=1e-12)
    around = masses["wire"] * WIRE.radius**2 / 2 + masses["catheter"] * CATHETER.radius**2 / 2
    assert np.allclose(model.body_inertia[bodies, 2], around, rtol=1e-12)
    low, high = links(simulation).T
    assert np.allclose(model.body_inertia[bodies, 0], total * (high - low) ** 2 / 12 + around / 2, rtol=1e-12)


def test_joints_have_the_stiffness_and_damping_of_their_cell(simulation: DualSimulation, lead: float) -> None:
    model = simulation.model
    low, high = links(simulation).T
    middle = (low + high) / 2
    backs = {"wire": max(-lead, 0.0), "catheter": max(lead, 0.0)}

    def sections(s: float) -> list[tuple[float, float]]:
        devices = (("wire", WIRE), ("catheter", CATHETER))
        there = [(device, s - backs[name]) for name, device in devices if s >= backs[name]]
        return [(float(device.stiffness(at)), device.relaxation) for device, at in there]

    def flexibility(s: float) -> float:
        return 1 / sum(bending for bending, _ in sections(s))

    def relaxation(s: float) -> float:
        return flexibility(s) * sum(bending * time for bending, time in sections(s))

    steps = [*backs.values(), *(backs["catheter"] + at for at in CATHETER.taper)]
    steps += [backs["wire"] + at for at in (*WIRE.taper, WIRE.tip_length)]
    for joint in range(1, simulation.active_links):
        cell = middle[joint], middle[joint - 1]
        inside = [at for at in steps if cell[0] < at < cell[1]] or None
        bend = quad(flexibility, *cell, points=inside, limit=200)[0]
        damping = quad(relaxation, *cell, points=inside, limit=200)[0] / (cell[1] - cell[0]) / bend
        for axis in "xy":
            hinge = model.joint(LINK_NAME.format(joint) + axis)
            assert model.jnt_stiffness[hinge.id] == pytest.approx(1 / bend, rel=2e-3)
            assert model.dof_damping[hinge.dofadr[0]] == pytest.approx(damping, rel=2e-3)


def test_longer_than_the_devices() -> None:
    with pytest.raises(ValueError, match="longer than the shorter device"):
        DevicePair(load_guidewire("default"), load_catheter("vertebral"), reach=1.4)
