"""A breathing vessel: still it changes nothing, slow it leaves the shapes of rest, friction goes with its wall."""

from __future__ import annotations

import dataclasses
import pickle
from collections.abc import Callable

import gymnasium
import numpy as np
import pytest

from cathsim import ACCURACY, NavigateEnv, Phantom, Simulation, load_guidewire
from cathsim.contact.breathing import Breathing

MakeSimulation = Callable[..., Simulation]
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
    with pytest.raises(ValueError, match="breathing must be None or a Breathing, got 'deep'"):
        NavigateEnv(type_1, breathing="deep")
    with pytest.raises(ValueError, match="a vessel breathes with contact 'sdf'"):
        Simulation(type_1, load_guidewire("default"), ACCURACY["fast"], contact="hulls", breathing=Breathing())


@pytest.mark.parametrize("settings", [{}, {"wall_stiffness": 0.5}])
def test_an_amplitude_of_zero_is_a_vessel_at_rest_bit_for_bit(
    make_simulation: MakeSimulation, settings: dict[str, float]
) -> None:
    still, moving = (make_simulation(breathing=one, **settings) for one in (None, Breathing(amplitude=0.0)))
    for simulation in (still, moving):
        fed(simulation, 60)
    assert np.array_equal(still.state(), moving.state())
    assert np.array_equal(still.force(), moving.force())


def test_a_slow_breath_leaves_the_shape_that_rest_in_a_displaced_vessel_has(
    type_1: Phantom,
) -> None:
    amplitude = float(np.linalg.norm(INHALED))
    breathing = Breathing(amplitude=amplitude, direction=tuple(INHALED), period=80.0)
    slow = Simulation(type_1, FRICTIONLESS, ACCURACY["accurate"], breathing=breathing)
    slow.reset(rotation=0.5)
    for _ in range(90):
        slow.advance(STEP, 0.0)
    while slow.data.time < 40.0:  # then it is inhaled, and stands
        slow.advance(0.0, 0.0)
    np.testing.assert_allclose(slow.vessel_displacement, INHALED, atol=1e-9)
    moved = dataclasses.replace(type_1, grid=type_1.grid.moved(INHALED))
    rest = fed(Simulation(moved, FRICTIONLESS, ACCURACY["accurate"]))
    for _ in range(150):
        rest.advance(0.0, 0.0)
    unmoved = fed(Simulation(type_1, FRICTIONLESS, ACCURACY["accurate"]))
    for _ in range(150):
        unmoved.advance(0.0, 0.0)
    apart = np.linalg.norm(slow.inserted_points() - rest.inserted_points(), axis=1).max()
    changed = np.linalg.norm(slow.inserted_points() - unmoved.inserted_points(), axis=1).max()
    assert changed > 2e-3  # it has gone along with the vessel
    assert apart < 1e-4
    assert slow.summary.force_mean == pytest.approx(rest.summary.force_mean, rel=0.02)


def test_the_wire_goes_along_with_the_vessel_breath_after_breath(make_simulation: MakeSimulation) -> None:
    simulation = fed(make_simulation(breathing=Breathing()))
    breaths = []
    for _ in range(10):
        rows = []
        for _ in range(40):
            simulation.advance(0.0, 0.0)
            speed = np.abs(simulation.joint_velocities()[2:]).max()
            rows.append((*simulation.tip_in_vessel, simulation.summary.force_max, speed))
        breaths.append(rows)
    periods = np.array(breaths)  # (breaths, steps, 5)
    assert simulation.valid
    # nothing grows: the last breaths repeat each other, in shape, force and speed
    np.testing.assert_allclose(periods[-1, :, :3], periods[-2, :, :3], atol=2e-4)
    assert periods[-1, :, 3].max() < 1.1 * periods[2:5, :, 3].max()
    assert periods[-1, :, 4].max() < 1.5 * periods[2:5, :, 4].max()
    assert np.ptp(periods[-1, :, 3]) > 0.01  # N: and it is felt


def test_friction_pulls_along_with_the_wall(type_1: Phantom) -> None:
    along = type_1.entries["descending"].direction
    pulls = {}
    for sign in (1.0, -1.0):
        breathing = Breathing(amplitude=0.005, direction=tuple(sign * along))
        wire = dataclasses.replace(load_guidewire("default"), friction=0.3)
        simulation = fed(Simulation(type_1, wire, ACCURACY["accurate"], breathing=breathing), 80)
        simulation.data.time = 0.0
        for _ in range(5):
            simulation.advance(0.0, 0.0)
        pulls[sign] = float(np.array(simulation.summary.mean_force[:]) @ along)
    # 0.17 N; 0.10 N, of the displacement alone, where friction takes the wall to be at rest
    assert pulls[1.0] - pulls[-1.0] > 0.135


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


def test_two_devices_breathe(type_1: Phantom) -> None:
    forces = []
    for breathing in (None, Breathing(amplitude=0.0), Breathing()):
        env = NavigateEnv(type_1, catheter="vertebral", accuracy="fast", observation="tip", breathing=breathing)
        env.reset(seed=0, options={"start": None})
        env.simulation.reset(0.05)
        for _ in range(40):
            env.step(np.array([1.0, 0.0, 0.8, 0.0]))
        assert env.simulation.valid
        forces.append(env.simulation.state())
    assert np.array_equal(forces[0], forces[1])
    assert not np.array_equal(forces[0], forces[2])


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
