"""Two devices are simulated: their composite rod, steered, restored, slipping, at other time steps."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad

from cathsim.anatomy import load_phantom
from cathsim.devices.catheter import Catheter
from cathsim.devices.hubs import Hubs
from cathsim.devices.pair import DevicePair
from cathsim.devices.shelf import load_catheter
from cathsim.devices.simulation import DualSimulation
from cathsim.guidewire import LINK_NAME, Guidewire, load_guidewire
from cathsim.presets import ACCURACY, Accuracy
from cathsim.simulation import Simulation


def made(
    catheter: str | None = "vertebral",
    *,
    wire: str | None = "default",
    numerics: Accuracy = ACCURACY["accurate"],
    **pair: object,
) -> DualSimulation:
    devices = DevicePair(load_guidewire(wire) if wire else None, load_catheter(catheter) if catheter else None, **pair)
    return DualSimulation(load_phantom("type_1"), devices, numerics, measure_penetration=True)


def steered(simulation: DualSimulation, steps: int, seed: int = 0) -> np.ndarray:
    generator = np.random.default_rng(seed)
    tips = []
    for _ in range(steps):
        wire, turn, catheter, catheter_turn = generator.uniform(-0.4, 1.0, 4)
        simulation.advance(0.002 * wire, 0.26 * turn, catheter=(0.002 * catheter, 0.26 * catheter_turn))
        tips.append(simulation.tip)
    return np.array(tips)


def test_stays_valid_and_out_of_the_wall() -> None:
    simulation = made("simmons2")
    depths = []
    for _ in range(4):
        steered(simulation, 40)
        depths.append(simulation.summary.penetration_max)
    assert simulation.valid
    assert simulation.insertion > 0.05
    assert max(depths) < 1e-3


@pytest.mark.parametrize(("catheter", "out"), [("simmons1", 0.02), ("pigtail", 0.05)])
def test_a_bent_catheter_stays_where_it_is_and_comes_back_into_the_sheath(catheter: str, out: float) -> None:
    simulation = made(catheter)
    simulation.reset(0.0, catheter=(0.0, 0.0))
    for _ in range(round(out / 0.002)):
        simulation.advance(0.002, 0.0, catheter=(0.002, 0.0))
    for translation in (0.002, -0.002):
        for _ in range(40):
            simulation.advance(translation, 0.0)
            assert simulation.device_insertions()[1] == pytest.approx(out, abs=2e-3)
            assert np.abs(simulation.feeder_forces()).max() < 5.0
    for _ in range(round(out / 0.002) + 10):
        simulation.advance(-0.002, 0.0, catheter=(-0.002, 0.0))
    assert simulation.device_insertions() == pytest.approx((0.0, 0.0), abs=2e-3)


def test_what_the_drive_cannot_move_slips_in_proportion() -> None:
    hubs = Hubs(made().pair, 0.3)
    hubs.set(0.05, (0.0, 0.0))
    assert hubs.command(0.10, (-0.002, 0.0), (0.0, 0.0), (-0.0005, 0.004))[0] == -0.0005
    hubs.arrive()
    assert hubs.insertions(0.0995) == pytest.approx((0.0995, 0.05))  # the wire's feeder has slipped
    assert hubs.command(0.0995, (-0.002, 0.0), (-0.001, 0.0), (-0.001, 0.004))[0] == -0.001
    hubs.arrive()
    assert hubs.insertions(0.0985) == pytest.approx((0.0985, 0.0495))
    assert hubs.command(0.0985, (-0.002, 0.0), (0.0, 0.0), (0.001, 0.004))[0] == 0.001  # pushed forwards by the rest
    hubs.arrive()
    assert hubs.lead == pytest.approx(0.049)


def test_lead_is_limited() -> None:
    simulation = made(most_ahead=0.02, most_behind=0.01)
    simulation.reset(0.05, catheter=(0.05, 0.0))
    for _ in range(20):
        simulation.advance(0.002, 0.0)
    assert simulation.device_lead == pytest.approx(0.02)
    for _ in range(40):
        simulation.advance(-0.002, 0.0)
    assert simulation.device_lead == pytest.approx(-0.01)
    assert simulation.device_insertions()[1] == pytest.approx(0.05, abs=1e-3)


def test_the_catheter_straightens_and_the_wire_lets_it_bend() -> None:
    """A shape returns when the wire is drawn back out of it."""
    simulation = made("simmons2", wire="stiff")
    simulation.reset(0.16, catheter=(0.16, 0.0))
    straight = np.linalg.norm(np.diff(simulation.device_points("catheter")[[0, -1]], axis=0))
    for _ in range(60):
        simulation.advance(-0.002, 0.0)
    bent = np.linalg.norm(np.diff(simulation.device_points("catheter")[[0, -1]], axis=0))
    assert bent < straight - 0.005


def test_the_wire_alone_as_a_pair_bends_as_the_bare_wire() -> None:
    """Without a catheter and without torsion both simulations are of one rod, but for the links' lengths."""
    pair = made(None, torsion="rigid")
    bare = Simulation(load_phantom("type_1"), load_guidewire("default"), ACCURACY["accurate"])
    for simulation in (pair, bare):
        simulation.reset(0.0)
        for _ in range(60):
            simulation.advance(0.002, 0.0)
    assert np.linalg.norm(pair.tip - bare.tip) < 5e-3


def test_refuses_a_start_that_cannot_be() -> None:
    simulation = made()
    for arguments, message in (
        ({"insertion": -0.01}, "insertion of the wire must lie in"),
        ({"insertion": 0.05, "catheter": (-0.02, 0.0)}, "insertion of the catheter must lie in"),
        ({"insertion": 0.0, "catheter": (0.25, 0.0)}, "ahead of the catheter"),
        ({"insertion": float("nan")}, "ahead of the catheter"),
        ({"insertion": 0.1, "catheter": (0, float("inf"))}, "catheter's insertion .m. and rotation .rad. must be fini"),
    ):
        with pytest.raises(ValueError, match=message):
            simulation.reset(**arguments)


@pytest.mark.parametrize("devices", [{"wire": None}, {"catheter": None}])
def test_refuses_what_is_meant_for_an_absent_device(devices: dict) -> None:
    simulation = made(**devices)
    with pytest.raises(ValueError, match=r"the pair has one device, .*: leave catheter out"):
        simulation.advance(0.0, 0.0, catheter=(0.002, 0.0))
    with pytest.raises(ValueError, match=r"the pair has one device, .*: leave catheter out"):
        simulation.reset(0.0, 0.0, catheter=(0.05, 0.0))
    with pytest.raises(ValueError, match="has no tip motors: leave motors out"):
        simulation.advance(0.0, 0.0, np.zeros(3))
    simulation.advance(0.002, 0.0, catheter=(0.0, 0.0))
    simulation.reset(0.05, 0.1, catheter=(0.05, 0.1))


def test_refuses_tip_motors_and_hulls() -> None:
    simulation = made()
    for extra in ({"tip_motors": True}, {"contact": "hulls"}):
        with pytest.raises(ValueError, match="without tip motors"):
            DualSimulation(simulation.phantom, simulation.pair, simulation.numerics, **extra)
    with pytest.raises(ValueError, match="unknown device"):
        simulation.device_points("sheath")
    with pytest.raises(ValueError, match="expected a state"):
        simulation.restore(np.zeros(3))


def test_a_log_of_before_is_stepped_as_then() -> None:
    recorded = Accuracy(timestep=0.01, refinement=8, tolerance=2e-4, rise=5e-5, mass_scale=10.0)
    for numerics, expected in ((recorded, (8, 2.0)), (ACCURACY["accurate"], (3, 1.5))):
        struct = made("simmons2", numerics=numerics)._chain.struct
        assert (struct.refinement, struct.deep) == expected


def test_the_catheters_feeder_is_pushed_back_by_its_shape() -> None:
    """The feeder's force is minus the derivative of the energy by the catheter's insertion."""
    simulation = made("simmons2")
    simulation.reset(0.10, catheter=(0.06, 0.0))
    for _ in range(5):
        simulation.advance(0.0, 0.0)
    rod = simulation._chain.rod
    step = 1e-4
    lead = simulation.device_lead
    slope = (rod.energy(simulation.data, lead - step) - rod.energy(simulation.data, lead + step)) / (2 * step)
    forces = simulation.feeder_forces()
    assert forces[1] == pytest.approx(slope, rel=0.05)
    assert abs(forces[1]) > 1e-3


def test_refuses_movements_that_are_not_finite() -> None:
    simulation = made()
    place = simulation.device_insertions()
    for place_of_value, value in enumerate((float("nan"), float("inf"), float("nan"), float("inf"))):
        moves = [0.0] * 4
        moves[place_of_value] = value
        with pytest.raises(ValueError, match=f"must be finite numbers, got .*{value}"):
            simulation.advance(*moves[:2], catheter=(moves[2], moves[3]))
    assert simulation.device_insertions() == place


NUMERICS = ACCURACY["accurate"]
WIRE = load_guidewire("default", friction=0.04, relaxation=0.05)
# tapers lie across links and joints at every lead; friction and relaxation differ from the wire's
CATHETER = Catheter(taper=(0.011, 0.043), friction=0.17, relaxation=0.2, shape=((0.0, 0.012, 0.7, 0.0),))
# of the wire before the catheter, m: at a link's end, within links of each length, and the wire drawn back
LEADS = (0.0, 0.0135, 0.024, 0.131, -0.021)


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


def test_a_joint_that_is_folded_back_passes_on_a_bounded_twist(simulation: DualSimulation) -> None:
    simulation.reset(0.14, catheter=(0.14, 0.0))
    model, data, rod = simulation.model, simulation.data, simulation._rod
    hinges = [model.joint(LINK_NAME.format(6) + axis).qposadr[0] for axis in "xy"]
    data.qpos[hinges[0] - 4 : hinges[1] + 5] = 0.2
    data.qpos[hinges] = np.pi - 1e-3, 1e-3  # there a pole was: a tree's episode ended with a state that was not finite
    rod.place(rod.struct.lead, (2.0, -2.0))
    rod.untwist(data)
    assert np.abs(model.qpos_spring).max() < 3
