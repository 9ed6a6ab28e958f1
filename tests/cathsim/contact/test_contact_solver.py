"""Contact with the wall: forces are those of MuJoCo's solver, distances exact, walls compliant and breathing."""

import copy
import dataclasses
import pickle
from typing import Any

import gymnasium
import numpy as np
import pytest

from cathsim import ACCURACY, NavigateEnv, Phantom, Simulation, load_guidewire
from cathsim.anatomy import load_phantom
from cathsim.contact.breathing import Breathing
from cathsim.devices.active_chain import ActiveChain
from cathsim.devices.pair import DevicePair
from cathsim.devices.shelf import load_catheter
from cathsim.devices.simulation import DualSimulation
from cathsim.guidewire import Guidewire
from tests.cathsim.drawn_vessels import sphere, tube
from tests.cathsim.makers import MakeSimulation

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


def test_distance_and_normal_of_a_sphere() -> None:
    """Near the wall the spline is off by spacing^2 / 8 x curvature, 2 / radius, and no more."""
    radius = 0.006
    rng = np.random.default_rng(2)
    direction = rng.normal(size=(500, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    rho = radius + rng.uniform(-0.001, 0.001, (500, 1))
    distance, gradient = sphere(radius).distance(rho * direction)
    np.testing.assert_allclose(distance, radius - rho[:, 0], atol=1.4 * 0.001**2 / 8 * 2 / radius)
    normal = gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
    assert np.degrees(np.arccos(np.clip(-(normal * direction).sum(1), -1, 1))).max() < 1.0


def test_gradient_is_the_distances_derivative() -> None:
    vessel = sphere(0.008)
    points = np.random.default_rng(4).uniform(-0.008, 0.008, (100, 3))
    gradient = vessel.distance(points)[1]
    step = 1e-7
    for axis in range(3):
        shift = step * np.eye(3)[axis]
        slope = (vessel.distance(points + shift)[0] - vessel.distance(points - shift)[0]) / (2 * step)
        np.testing.assert_allclose(gradient[:, axis], slope, atol=1e-5)


def test_a_flared_sheath_widens_to_its_mouth_without_a_step() -> None:
    vessel = tube(sheath_radius=0.75e-3, sheath_flare=3e-3)
    heights = np.array([-0.5, -0.0101, -0.0099, -0.007, -0.005])
    distance, gradient = vessel.distance(np.array([[0.0005, 0.0, height] for height in heights]))
    wider = 3e-3 * np.clip(1 + heights / 0.010, 0, 1) ** 2
    slope = 0.6 * np.clip(1 + heights / 0.010, 0, 1)
    np.testing.assert_allclose(distance, (0.00025 + wider) / np.hypot(1, slope), atol=1e-9)
    np.testing.assert_allclose(gradient, np.array([-1 + 0 * slope, 0 * slope, slope]).T / np.hypot(1, slope)[:, None])


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


STEP = 0.002  # m
INHALED = np.array([0.003, 0.0, -0.004])  # m
FRICTIONLESS = dataclasses.replace(load_guidewire("default"), friction=0.0)


def fed(simulation: Simulation, steps: int = 90) -> Simulation:
    simulation.reset(rotation=0.5)
    for _ in range(steps):
        simulation.advance(STEP, 0.0)
    return simulation


def test_the_displacement_is_nothing_exhaled_and_the_amplitude_inhaled() -> None:
    breathing = Breathing(amplitude=0.004, direction=(0.0, 0.5, 0.0), period=2.0)
    np.testing.assert_allclose(breathing.displacement(0.0), 0.0)
    np.testing.assert_allclose(breathing.displacement(1.0), (0.0, 0.004, 0.0), atol=1e-12)
    np.testing.assert_allclose(breathing.displacement(0.5), (0.0, 0.002, 0.0), atol=1e-12)
    for time in (0.3, 0.9, 1.7):
        slope = (breathing.displacement(time + 1e-6) - breathing.displacement(time - 1e-6)) / 2e-6
        np.testing.assert_allclose(breathing.velocity(time), slope, atol=1e-9)


def test_bad_breathing_is_refused(type_1: Phantom) -> None:
    with pytest.raises(ValueError, match=r"amplitude must lie in 0 to 0.02 m, got 5"):
        Breathing(amplitude=5)
    with pytest.raises(ValueError, match="direction must not be zero"):
        Breathing(direction=(0, 0, 0))
    with pytest.raises(ValueError, match="breathing must be a Breathing, got 'deep'"):
        NavigateEnv(type_1, breathing="deep")
    with pytest.raises(ValueError, match="a vessel breathes with contact 'sdf'"):
        Simulation(type_1, load_guidewire("default"), ACCURACY["fast"], contact="hulls", breathing=Breathing())


def test_a_slow_breath_leaves_the_shape_that_rest_in_a_displaced_vessel_has(type_1: Phantom) -> None:
    amplitude = float(np.linalg.norm(INHALED))
    breathing = Breathing(amplitude=amplitude, direction=tuple(INHALED), period=80.0)
    slow = Simulation(type_1, FRICTIONLESS, ACCURACY["accurate"], breathing=breathing)
    fed(slow)
    while slow.data.time < 40.0:  # then it is inhaled, and stands
        slow.advance(0.0, 0.0)
    np.testing.assert_allclose(slow.vessel_displacement, INHALED, atol=1e-9)
    moved = dataclasses.replace(type_1, grid=type_1.grid.moved(INHALED))
    rest, unmoved = (fed(Simulation(one, FRICTIONLESS, ACCURACY["accurate"])) for one in (moved, type_1))
    for _ in range(150):
        rest.advance(0.0, 0.0)
        unmoved.advance(0.0, 0.0)
    apart = np.linalg.norm(slow.inserted_points() - rest.inserted_points(), axis=1).max()
    changed = np.linalg.norm(slow.inserted_points() - unmoved.inserted_points(), axis=1).max()
    assert changed > 2e-3  # it has gone along with the vessel
    assert apart < 1e-4
    assert slow.summary.force_mean == pytest.approx(rest.summary.force_mean, rel=0.02)


def test_state_and_pickle_go_on_in_the_same_breath(make_simulation: MakeSimulation) -> None:
    simulation = fed(make_simulation(breathing=Breathing(period=3.0)), 45)
    twin = pickle.loads(pickle.dumps(simulation))
    other = make_simulation(breathing=Breathing(period=3.0))
    other.restore(simulation.state())
    for one in (simulation, twin, other):
        for _ in range(10):
            one.advance(STEP, 0.1)
    assert np.array_equal(simulation.state(), twin.state())
    assert np.array_equal(simulation.state(), other.state())


def test_the_target_moves_with_the_vessel_and_the_roadmap_does_not(type_1: Phantom) -> None:
    breathing = Breathing(amplitude=0.005, direction=(0, 0, -1), period=4.0)
    env = gymnasium.make(
        "cathsim:cathsim/Navigate-v0",
        phantom=type_1,
        observation=("tip", "goal"),
        breathing=breathing,
        disable_env_checker=True,
    ).unwrapped
    assert isinstance(env, NavigateEnv)
    times = set()
    for seed in range(4):
        observation, info = env.reset(seed=seed)
        times.add(round(env.simulation.data.time, 6))
        shift = breathing.displacement(env.simulation.data.time)
        target = type_1.target("bca").position
        assert info["distance"] == pytest.approx(np.linalg.norm(info["tip"] - shift - target), abs=1e-12)
        np.testing.assert_allclose(observation["goal"], target, atol=1e-6)
    assert len(times) == 4  # anywhere in a breath
    assert all(0 <= time < 4 for time in times)
    again = gymnasium.make(gymnasium.envs.registration.EnvSpec.from_json(env.spec.to_json())).unwrapped
    assert again.simulation.breathing == breathing
