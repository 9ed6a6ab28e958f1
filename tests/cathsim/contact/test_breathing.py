"""A breathing vessel: still it changes nothing, slow it leaves the shapes of rest, friction goes with its wall."""

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
    with pytest.raises(ValueError, match="breathing must be a Breathing, got 'deep'"):
        NavigateEnv(type_1, breathing="deep")
    with pytest.raises(ValueError, match="a vessel breathes with contact 'sdf'"):
        Simulation(type_1, load_guidewire("default"), ACCURACY["fast"], contact="hulls", breathing=Breathing())


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
