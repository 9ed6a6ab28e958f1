"""Navigation towards goals: rewards, draws, limits, messages."""

import numpy as np
import pytest

from cathsim import NavigateEnv
from cathsim.contact.breathing import Breathing
from cathsim.goals.environment import NavigateGoalEnv
from cathsim.goals.task import GoalTask


def test_the_reward_of_a_step_is_that_of_its_goals() -> None:
    for breathing in (None, Breathing(0.005)):
        env = NavigateGoalEnv("type_1", ("bca",), accuracy="fast", breathing=breathing)
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


def test_every_reset_draws_a_goal_within_reach() -> None:
    environment = NavigateGoalEnv("type_1", accuracy="fast")
    drawn = {tuple(environment.reset(seed=seed)[0]["desired_goal"]) for seed in range(8)}
    drawn |= {tuple(environment.reset()[0]["desired_goal"]) for _ in range(8)}
    assert len(drawn) > 10
    assert drawn <= set(environment.goals)
    longest = max(environment.phantom.way_length(goal) for goal in environment.goals)
    assert longest < environment.simulation.max_insertion + 0.02
    again = environment.reset(seed=3)[0]["desired_goal"]
    environment.reset()
    assert np.array_equal(environment.reset(seed=3)[0]["desired_goal"], again)


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


REACHED = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
WANTED = np.array([[0.0, 0.0, 0.007], [0.0, 0.008, 0.0], [0.03, 0.0, 0.04]])


def test_a_goal_task_rewards_its_own_target_alike_in_an_environment_of_one_target() -> None:
    for reward in ("sparse", "dense"):
        env = NavigateEnv("type_1", task=GoalTask(reward=reward), accuracy="fast")
        env.reset(seed=0)
        _, given, _, _, info = env.step(np.array([1.0, 0.0]))
        assert given == pytest.approx(-1.0 if reward == "sparse" else -info["distance"])
    own = NavigateEnv("type_1", task=GoalTask(reward=lambda achieved, desired, info: 0.0), accuracy="fast")
    own.reset(seed=0)
    with pytest.raises(ValueError, match="take NavigateGoalEnv"):
        own.step(np.array([1.0, 0.0]))


def test_sparse_and_dense_rewards() -> None:
    assert np.array_equal(GoalTask().goal_reward(REACHED, WANTED, {}), [0.0, 0.0, -1.0])
    dense = GoalTask(reward="dense").goal_reward(REACHED, WANTED, {})
    np.testing.assert_allclose(dense, [-0.007, -0.008, -0.05])
    assert GoalTask(success_radius=0.06).goal_reward(REACHED[2], WANTED[2], {}) == 0.0
    assert GoalTask().goal_reward(REACHED.reshape(1, 3, 3), WANTED.reshape(1, 3, 3), {}).shape == (1, 3)


def test_forces_are_subtracted() -> None:
    task = GoalTask(force_penalty=0.5)
    infos = [{"force": 1.0}, {"force": 0.0}, {"force": 2.0}]
    assert np.array_equal(task.goal_reward(REACHED, WANTED, infos), [-0.5, 0.0, -2.0])
    assert task.goal_reward(REACHED[0], WANTED[0], infos[0]) == -0.5
    above = GoalTask(force_penalty=0.5, force_threshold=1.5)
    assert np.array_equal(above.goal_reward(REACHED, WANTED, infos), [0.0, 0.0, -1.25])
    with pytest.raises(ValueError, match=r"needs info\['force'\]"):
        task.goal_reward(REACHED, WANTED, [{}, {}, {}])


@pytest.mark.parametrize("given", [0.0, np.zeros(2), np.full(3, np.nan), "much"])
def test_a_wrong_reward_is_refused(given: object) -> None:
    task = GoalTask(reward=lambda achieved, desired, info: given)
    with pytest.raises(ValueError, match=r"must give finite numbers of shape \(3,\), gave"):
        task.goal_reward(REACHED, WANTED, {})
