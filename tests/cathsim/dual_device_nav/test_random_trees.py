"""The environment of random trees: trees and targets of episodes, devices, repetition, copies, messages."""

import gymnasium
import pytest

import enn
from cathsim import load_guidewire
from cathsim.dual_device_nav import GOALS, LENGTH, RandomTreesEnv
from cathsim.registration import COPIES


@pytest.fixture(scope="module")
def environment() -> RandomTreesEnv:
    return RandomTreesEnv((4, 5))


def test_every_episode_has_a_tree_and_a_point_of_a_carotid_or_vertebral(environment: RandomTreesEnv) -> None:
    environment.reset(seed=0)
    seen, branches = set(), set()
    for _ in range(8):
        observation, info = environment.reset()
        seen.add(info["phantom"])
        branches.add(environment.phantom.target(environment.task.target).branch)
        assert info["branch"] == "aorta"
        assert observation.shape == (18,)
    assert seen == {"random_tree_4", "random_tree_5"}
    assert branches <= set(GOALS)
    assert len(branches) > 2
    assert environment.task.max_steps == 1000


def test_devices_reach_every_vessels_end(environment: RandomTreesEnv) -> None:
    for case in range(2):
        for name in GOALS[2:]:
            environment.reset(options={"case": case, "target": f"{name}_end"})
    pair = environment.simulation.pair
    assert (pair.catheter.length, pair.wire.working_length) == (LENGTH, LENGTH)


def test_a_tree_has_perturbed_copies() -> None:
    wire = load_guidewire("default").scaled(0.6)
    arguments = {"phantom": "random_tree_4", "targets": ("rcca",), "copies": (0, 1), "wire": wire}
    copies = gymnasium.make(COPIES, disable_env_checker=True, **arguments)
    _, info = copies.reset(seed=0, options={"case": 1})
    assert info["phantom"] == "random_tree_4_copy1"


def test_a_policy_of_arches_steers_up_a_tree() -> None:
    """It was trained in ways of 0.28 m at most, and fails here where it is shown the whole way.

    A seed gives other episodes on other processors, of which one in ten fails.
    """
    policy = enn.load("arch_variety_jb2")
    environment = RandomTreesEnv(range(5000, 5020), observation=policy.keys, max_steps=400)
    success = False
    for seed in (5, 4, 3):
        observation, info = environment.reset(seed=seed, options={"case": 3})
        controller, ended = policy.controller(deterministic=False, seed=seed), False
        while not ended:
            observation, _, success, truncated, info = environment.step(controller(observation, info))
            ended = success or truncated
        if success:
            break
    assert success
    assert info["branch"] != "aorta"
    assert info["insertion"] > 0.5
