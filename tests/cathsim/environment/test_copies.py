"""Copies of environments: pickled, copied deeply, saved and restored; each goes on bit for bit like its original."""

import copy
import pickle
import zlib
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest

from cathsim import ENVIRONMENT, NavigationTask, Phantom, load_guidewire
from cathsim.blood.flow import BloodFlow
from cathsim.contact.breathing import Breathing
from cathsim.fluoroscopy import BiplaneFluoroscope
from cathsim.observations.observables import DEVICES, OBSERVABLES
from cathsim.vector import ThreadedVectorEnv
from tests.cathsim.equal_observations import same
from tests.cathsim.forward_actions import forward_actions
from tests.cathsim.makers import MakeEnv

SMALL: dict[str, Any] = {"image_size": 32, "accuracy": "fast"}
VARIANTS: dict[str, dict[str, Any]] = {
    "everything seen": {"observation": OBSERVABLES, "start_rotation": 2.0, "registration_noise": 1e-3},
    "cameras": {"observation": ("image_a", "mask_a", "image_b", "sequential"), "cameras": "guide3d"},
    "blood of one's own": {"observation": "joints", "blood": BloodFlow(peak_velocity=0.5, phase=0.2)},
    "blood and breathing": {"observation": "joints", "blood": "steady", "breathing": Breathing()},
    "robot": {"observation": ("feeder", "shape"), "drive": "robot"},
    "tip motors": {"actions": "tip_motors", "observation": ("internal", "image")},
    "own wire and task": {
        "wire": load_guidewire("default", friction=0.1).scaled(0.3),
        "task": NavigationTask(target="lcca", max_steps=60),
        "contact_info": True,
    },
    "two devices": {"catheter": "simmons2", "observation": (*OBSERVABLES, DEVICES)},
    "two robots": {"catheter": "simmons2", "drive": "robot"},
}
WAYS: dict[str, Callable[[Any], Any]] = {
    "pickle": lambda env: pickle.loads(pickle.dumps(env)),
    "deepcopy": copy.deepcopy,
}


def go_on_alike(original: Any, twin: Any, steps: int = 12) -> None:
    """Both give the same: now, for some steps, and in the next episode."""
    assert same(original.observe(), twin.observe())
    assert same(original.render(), twin.render())
    for action in forward_actions(steps, *original.action_space.shape, seed=1):
        one, other = original.step(action), twin.step(action)
        assert same(one, other)
        if one[2] or one[3]:
            break
    assert same(original.reset(), twin.reset()), "draws of the next episode"
    assert same(original.step(action), twin.step(action))


@pytest.mark.parametrize(
    ("variant", "way"),
    [
        *((variant, "pickle") for variant in VARIANTS if variant != "two robots"),
        ("everything seen", "deepcopy"),
        ("two robots", "deepcopy"),
    ],
)
def test_copies_in_the_middle_of_an_episode_go_on_alike(make_env: MakeEnv, variant: str, way: str) -> None:
    env = make_env(**{**SMALL, **VARIANTS[variant]})
    env.reset(seed=3)
    for action in forward_actions(45, *env.action_space.shape):
        env.step(action)
    twin = WAYS[way](env)
    assert way == "pickle" or twin.phantom is env.phantom
    assert same(twin.simulation.blood_forces(), env.simulation.blood_forces())
    go_on_alike(env, twin)


def test_copies_have_the_cameras_of_ones_own(make_env: MakeEnv, type_1: Phantom) -> None:
    cameras = BiplaneFluoroscope.of(type_1, "clinical", size=48, surroundings="patient", filling="contrast")
    env = make_env(phantom=type_1, cameras=cameras, observation="image_b")
    env.reset(seed=0)
    env.step(np.ones(2))
    go_on_alike(env, WAYS["pickle"](env), steps=3)


@pytest.mark.parametrize("way", WAYS)
def test_copies_of_wrapped_and_of_vector_environments(way: str) -> None:
    env = gymnasium.make(ENVIRONMENT, accuracy="fast", max_episode_steps=40)
    env.reset(seed=0)
    env.step(np.ones(2, np.float32))
    twin = WAYS[way](env)
    for _ in range(5):
        assert same(env.step(np.ones(2, np.float32)), twin.step(np.ones(2, np.float32)))
    vector = ThreadedVectorEnv(2, threads=2, accuracy="fast", observation="joints")
    vector.reset(seed=0)
    vector.step(np.ones((2, 2)))
    other = WAYS[way](vector)
    for _ in range(3):
        assert same(vector.step(np.ones((2, 2))), other.step(np.ones((2, 2))))
    vector.close()
    other.close()


def test_what_is_no_saved_moment_is_one_sentence(make_env: MakeEnv) -> None:
    env = make_env()
    env.reset(seed=0)
    saved = env.state()
    partial = {key: value for key, value in saved.items() if key != "robots"}
    for other, got in ((partial, "dict without robots"), ({}, "dict without ended, forces, "), (None, "NoneType")):
        with pytest.raises(ValueError, match=f"expected what env.state\\(\\) gave, got {got}"):
            env.restore(other)
    assert same(env.state(), saved)


def test_the_robot_is_saved_in_every_phase_of_its_cycle(make_env: MakeEnv) -> None:
    env, other = (make_env(drive="robot", observation="feeder") for _ in range(2))
    env.reset(seed=0)
    other.reset(seed=1)
    phases = set()
    for _ in range(60):
        env.step(np.array([1.0, 0.5]))
        phases.add(env.robot.phase)
        saved = env.state()
        other.restore(saved)
        ahead = [other.step(np.array([1.0, -0.5]))[0] for _ in range(2)]
        other.restore(saved)
        assert all(same(other.step(np.array([1.0, -0.5]))[0], one) for one in ahead)
    assert len(phases) >= 4


def test_a_pickle_opens_in_another_process(make_env: MakeEnv, tmp_path: Any, run_python: Callable[[str], str]) -> None:
    env = make_env(observation=("internal", "image"), image_size=32)
    env.reset(seed=1)
    for action in forward_actions(30, *env.action_space.shape):
        env.step(action)
    file = tmp_path / "environment"
    file.write_bytes(pickle.dumps(env))
    going_on = (
        "[(reward, [zlib.crc32(seen[name].tobytes()) for name in ('internal', 'image')]) "
        "for seen, reward, *_ in (env.step([1.0, -0.3]) for _ in range(10))]"
    )
    printed = run_python(f"import pickle, zlib\nenv = pickle.load(open({str(file)!r}, 'rb'))\nprint({going_on})")
    assert printed.strip() == repr(eval(going_on, {"env": env, "zlib": zlib}))
