"""The goal-conditioned environment: Gymnasium's contract, drawn goals, repetition, registration, messages."""

from __future__ import annotations

import json

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env

from cathsim import NavigateEnv, NavigationTask
from cathsim.contact.breathing import Breathing
from cathsim.goals.environment import NavigateGoalEnv
from cathsim.registration import GOAL

pytestmark = pytest.mark.filterwarnings("ignore:.*(minimum value is -inf|maximum value is inf)")


@pytest.fixture(scope="module")
def environment() -> NavigateGoalEnv:
    return NavigateGoalEnv("type_1", accuracy="fast")


def test_the_registered_environment_passes_the_checker() -> None:
    env = gymnasium.make(GOAL, accuracy="fast")
    check_env(env.unwrapped, skip_render_check=True)
    assert env.spec is not None
    again = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
    one, other = env.reset(seed=4), again.reset(seed=4)
    assert all(np.array_equal(one[0][key], other[0][key]) for key in one[0])
    env.close()
    again.close()


def test_the_reward_of_a_step_is_that_of_its_goals(environment: NavigateGoalEnv) -> None:
    for breathing in (None, Breathing(0.005)):
        env = environment if breathing is None else NavigateGoalEnv("type_1", accuracy="fast", breathing=breathing)
        env.reset(seed=1)
        seen, infos, rewards = [], [], []
        for _ in range(6):
            observation, reward, _, _, info = env.step(np.array([1.0, 0.2]))
            assert env.observation_space.contains(observation)
            assert info["is_success"] == info["success"]
            away = np.linalg.norm(observation["achieved_goal"] - observation["desired_goal"])
            assert away == pytest.approx(info["distance"], rel=1e-12)
            seen.append(observation)
            infos.append(info)
            rewards.append(reward)
        achieved, desired = (np.array([one[f"{kind}_goal"] for one in seen]) for kind in ("achieved", "desired"))
        assert np.array_equal(env.compute_reward(achieved, desired, infos), rewards)
        assert set(rewards) == {-1.0}
        assert np.array_equal(env.compute_reward(achieved, achieved, infos), np.zeros(6))
        alone = env.compute_reward(achieved[0], achieved[0], infos[0])
        assert (alone, type(alone)) == (0.0, float)


def test_every_reset_draws_a_goal_within_reach(environment: NavigateGoalEnv) -> None:
    drawn = {tuple(environment.reset(seed=seed)[0]["desired_goal"]) for seed in range(8)}
    drawn |= {tuple(environment.reset()[0]["desired_goal"]) for _ in range(8)}
    assert len(drawn) > 10
    assert drawn <= set(environment.goals)
    longest = max(environment.phantom.way_length(goal) for goal in environment.goals)
    assert longest < environment.simulation.max_insertion + 0.02
    again = environment.reset(seed=3)[0]["desired_goal"]
    environment.reset()
    assert np.array_equal(environment.reset(seed=3)[0]["desired_goal"], again)


def test_the_start_is_that_of_the_plain_environment(environment: NavigateGoalEnv) -> None:
    _, info = environment.reset(seed=9)
    plain = NavigateEnv("type_1", environment.task.target, accuracy="fast")
    assert np.array_equal(plain.reset(seed=9)[1]["tip"], info["tip"])
    action = np.array([1.0, 0.5])
    assert np.array_equal(plain.step(action)[4]["tip"], environment.step(action)[4]["tip"])


def test_a_goal_may_be_given_and_reaching_it_ends_the_episode() -> None:
    env = NavigateGoalEnv("type_1", ("bca", (0.05, 0.012, -0.07)), observation=("tip", "force"), accuracy="fast")
    assert len(env.goals) == 2
    observation, _ = env.reset(seed=0, options={"target": env.goals[1]})
    assert observation["observation"].shape == (6,)
    for _ in range(40):
        observation, reward, terminated, truncated, info = env.step(np.array([1.0, 0.0]))
        if terminated or truncated:
            break
    assert terminated
    assert info["is_success"]
    assert reward == 0.0
    assert np.array_equal(observation["desired_goal"], env.goals[1])


def test_an_image_is_observed_alone() -> None:
    env = NavigateGoalEnv("type_1", observation="image", image_size=32, accuracy="fast")
    observation, _ = env.reset(seed=0)
    assert observation["observation"].shape == (1, 32, 32)
    assert env.observation_space.contains(observation)


def test_vectors_draw_their_own_goals() -> None:
    vector = gymnasium.make_vec(GOAL, 2, threads=1, accuracy="fast")
    observation, _ = vector.reset(seed=0)
    assert observation["desired_goal"].shape == (2, 3)
    assert not np.array_equal(*observation["desired_goal"])
    vector.close()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"observation": ("joints", "roadmap")}, "observation roadmap depends on the target.* leave it out"),
        (
            {"observation": ("joints", "image")},
            "an image can only be observed alone beside the goals, got joints, image",
        ),
        ({"goals": ()}, "goals must list at least one name or point"),
        ({"goals": "bca"}, "goals must list at least one name or point, got 'bca'"),
        ({"goals": ("bca", "nowhere")}, "nowhere"),
        ({"target": "bca"}, "takes goals, a list, instead of a target"),
        ({"task": NavigationTask()}, "task must be a GoalTask"),
        ({"reward": "geodesic"}, "unknown reward 'geodesic'; there are sparse, dense"),
        ({"path_penalty": 1.0}, "path_penalty must be 0"),
    ],
    ids=lambda value: json.dumps(value, default=str) if isinstance(value, dict) else "",
)
def test_wrong_arguments_are_refused(arguments: dict[str, object], message: str) -> None:
    with pytest.raises((ValueError, KeyError), match=message) as caught:
        NavigateGoalEnv("type_1", **{"accuracy": "fast", **arguments})  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)
