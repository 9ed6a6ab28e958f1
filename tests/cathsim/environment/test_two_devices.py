"""The environment of a wire in a catheter: actions, observations, info, copies, robots, and bad input."""

import gymnasium
import numpy as np
import pytest

from cathsim.devices.shelf import load_catheter
from cathsim.devices.simulation import DualSimulation
from cathsim.observations.observables import DEVICES, OBSERVABLES
from cathsim.registration import DUAL
from tests.cathsim.forward_actions import forward_actions
from tests.cathsim.makers import MakeEnv

EVERYTHING = (*OBSERVABLES, DEVICES)


def test_a_wire_in_a_catheter_keeps_the_contract(make_env: MakeEnv) -> None:
    env = make_env(catheter="pigtail", observation=EVERYTHING, image_size=40, target="lcca", start_rotation=1.0)
    assert env.action_space == gymnasium.spaces.Box(-1, 1, (4,), np.float32)
    space, links = env.observation_space, len(env.simulation.wire.links)
    assert isinstance(space, gymnasium.spaces.Dict)
    sizes = {"internal": 28 * links, "joints": 4 * links, "feeder": 7, "roadmap": 71, "history": 18}
    assert {name: space[name].shape for name in sizes} == {name: (size,) for name, size in sizes.items()}
    assert space["shape"].shape == (links + 1, 3)
    assert space["devices"].shape == (2, 5)
    observation, info = env.reset(seed=1)
    for action in forward_actions(20, 4):
        assert space.contains(observation)
        assert all(np.isfinite(value).all() for value in observation.values())
        assert info["feeder_forces"].shape == (2,)
        observation, reward, _, _, info = env.step(action)
        assert np.isfinite(reward)
        assert not info["invalid"]
    simulation = env.simulation
    assert isinstance(simulation, DualSimulation)
    assert info["lead"] == pytest.approx(info["insertion"] - info["catheter_insertion"])
    wire, catheter_row = observation["devices"]
    assert wire[0] == np.float32(info["insertion"])
    assert catheter_row[0] == np.float32(info["catheter_insertion"])
    assert catheter_row[1] == np.float32(info["catheter_rotation"])
    assert observation["feeder"][6] == np.float32(info["lead"])
    assert np.allclose(observation["devices"][:, 3], info["feeder_forces"], atol=1e-6)


def test_each_action_moves_its_own_part(make_env: MakeEnv) -> None:
    env = make_env(catheter="vertebral", observation="devices", start_jitter=0.0)
    for index in range(4):
        env.reset(seed=0)
        for _ in range(5):
            observation, *_, info = env.step(np.eye(4)[index])
        moved = [info["insertion"], info["rotation"], info["catheter_insertion"], info["catheter_rotation"]]
        assert moved[index] == pytest.approx((0.010, np.radians(75.0))[index % 2], rel=0.05)
        others = [value for other, value in enumerate(moved) if other != index]
        assert np.allclose(others, 0.0, atol=2e-4)
    assert observation.shape == (2, 5)


def test_elastic_torsion_lets_the_tip_lag(make_env: MakeEnv) -> None:
    angles = {}
    for torsion in ("elastic", "rigid"):
        env = make_env(catheter="simmons2", torsion=torsion, observation="devices", start_jitter=0.0)
        env.reset(seed=0)
        for action in [(1, 0, 1, 0)] * 60 + [(0, 0, 0, 1)] * 6:
            observation = env.step(np.array(action, float))[0]
        angles[torsion] = observation[1, 1:3]
    assert angles["elastic"][0] == pytest.approx(angles["rigid"][0])
    assert angles["elastic"][0] - angles["elastic"][1] > angles["rigid"][0] - angles["rigid"][1] + 0.02


def test_a_catheter_alone_has_two_actions(make_env: MakeEnv) -> None:
    env = make_env(wire=None, catheter="headhunter", observation=("feeder", "devices", "roadmap", "history"))
    assert env.action_space.shape == (2,)
    env.reset(seed=0)
    for _ in range(8):
        observation, *_, info = env.step(np.array([1.0, 0.5]))
    assert observation["feeder"].shape == (3,)
    assert not observation["devices"][0].any()
    assert info["insertion"] == info["catheter_insertion"] > 0.01
    assert info["lead"] == 0.0


def test_a_start_with_both_devices_is_an_option_of_reset(make_env: MakeEnv) -> None:
    env = make_env(catheter="vertebral", observation="devices")
    env.reset(seed=0)
    for action in forward_actions(20, 4):
        env.step(action)
    start, lead = env.start_state(), env.reset(seed=1)[1]["lead"]
    _, info = env.reset(seed=1, options={"start": start, "target": "lcca"})
    assert info["lead"] != lead
    assert np.array_equal(env.start_state(), start)
    actions = forward_actions(5, 4)
    first = [env.step(action)[0] for action in actions]
    env.reset(seed=2, options={"start": start})
    assert np.array_equal([env.step(action)[0] for action in actions], first)


def test_two_robots_feed_by_strokes(make_env: MakeEnv) -> None:
    env = make_env(catheter="vertebral", drive="robot", observation="feeder")
    _, info = env.reset(seed=0)
    seen = set()
    for step in range(60):
        *_, info = env.step(np.array([1.0, 0.0, 0.5 if step < 30 else 0.0, 0.0]))
        seen.add((info["driven"], info["catheter_driven"]))
    assert len(env.feeders.robots) == 2
    assert (False, True) in seen or (False, False) in seen
    assert any(catheter for _, catheter in seen)
    assert info["insertion"] > info["catheter_insertion"] > 0.005


def test_registered_with_a_vertebral_catheter() -> None:
    env = gymnasium.make(DUAL, accuracy="fast", observation="devices")
    assert env.unwrapped.simulation.pair.catheter == load_catheter("vertebral")
    env.close()


def test_a_catheter_alone_that_is_too_short_says_so(make_env: MakeEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cathsim.devices.pair.REACH", 0.2)
    with pytest.raises(ValueError, match="over 204 mm, which is too short for rcca_end"):
        make_env(wire=None, catheter="vertebral", target="rcca_end")
