"""ArchVariety: arches and targets of the episodes, reward, devices, messages."""

import numpy as np
import pytest

from cathsim.anatomy.point_target import points_beyond_root
from cathsim.arch_variety import ArchVarietyEnv, ArchVarietyTask

COARSE = {"resolution": 2e-3, "seeds": (4, 5)}


@pytest.fixture(scope="module")
def environment() -> ArchVarietyEnv:
    return ArchVarietyEnv(("I", "V"), **COARSE)


def test_every_episode_has_an_arch_and_a_point_above_its_aorta(environment: ArchVarietyEnv) -> None:
    environment.reset(seed=0)
    seen = set()
    for _ in range(12):
        observation, info = environment.reset()
        assert observation.shape == (16,)
        seen.add(info["phantom"])
        phantom, goal = environment.phantom, environment.current.goal
        away = np.linalg.norm(points_beyond_root(phantom.tree, phantom.grid) - goal, axis=1)
        assert away.min() == 0
        assert phantom.target(environment.task.target).branch != "aorta"
        assert info["target"] == environment.task.target_name
    assert seen == {f"arch_variety_{kind}_{seed}" for kind in ("I", "V") for seed in (4, 5)}


def test_a_target_may_be_given(environment: ArchVarietyEnv) -> None:
    _, info = environment.reset(seed=1, options={"case": 3, "target": "lsa_end"})
    assert (info["case"], info["phantom"], info["target"]) == (3, "arch_variety_V_5", "lsa_end")


def test_reaching_the_target_ends_the_episode(environment: ArchVarietyEnv) -> None:
    environment.reset(seed=5)
    for _ in range(8):
        environment.step(np.array([1.0, 0.0]))
    there = environment.simulation.tip
    environment.reset(seed=5, options={"target": there})
    for _ in range(12):
        _, reward, terminated, truncated, info = environment.step(np.array([1.0, 0.0]))
        if terminated or truncated:
            break
    assert terminated
    assert info["success"]
    assert info["distance"] <= 0.005
    assert 0.99 < reward < 1.01


def test_a_catheter_and_pictures() -> None:
    environment = ArchVarietyEnv(("VI",), catheter="simmons2", observation=("tracking", "image"), **COARSE)
    observation, _ = environment.reset(seed=1)
    assert (environment.action_space.shape, observation["tracking"].shape) == ((4,), (18,))
    assert observation["image"].shape == (1, 80, 80)


def test_reward_is_the_published_one() -> None:
    task = ArchVarietyTask()
    assert (task.success_radius, task.max_steps) == (0.005, 450)
    assert task.step_reward(0.1, 0.004, 0.3, success=False) == pytest.approx(0.001 * 4 - 0.005)
    assert task.step_reward(0.004, 0.004, 0.3, success=True) == pytest.approx(1.0 + 0.001 * 4 - 0.005)
    assert ArchVarietyTask(force_penalty=2.0).step_reward(0.1, 0.0, 0.3, success=False) == pytest.approx(-0.605)
    assert task.reads_progress
