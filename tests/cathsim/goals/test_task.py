"""The goal-conditioned task: its rewards of one and of many goals, penalties, functions, messages."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim.goals.task import GoalTask

REACHED = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
WANTED = np.array([[0.0, 0.0, 0.007], [0.0, 0.008, 0.0], [0.03, 0.0, 0.04]])


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
    with pytest.raises(ValueError, match=r"needs info\['force'\] of every step: keep the infos"):
        task.goal_reward(REACHED, WANTED, [{}, {}, {}])


def test_a_function_gives_the_reward() -> None:
    def along_z(achieved: np.ndarray, desired: np.ndarray, info: object) -> np.ndarray:
        return -np.abs(achieved - desired)[..., 2]

    np.testing.assert_array_equal(GoalTask(reward=along_z).goal_reward(REACHED, WANTED, {}), -WANTED[:, 2])


@pytest.mark.parametrize("given", [0.0, np.zeros(2), np.full(3, np.nan), "much"])
def test_a_wrong_reward_is_refused(given: object) -> None:
    task = GoalTask(reward=lambda achieved, desired, info: given)
    with pytest.raises(ValueError, match=r"must give finite numbers of shape \(3,\), gave"):
        task.goal_reward(REACHED, WANTED, {})


def test_shapes_have_to_fit() -> None:
    with pytest.raises(ValueError, match=r"two arrays of one shape \(..., 3\), got \(3, 3\) and \(3,\)"):
        GoalTask().goal_reward(REACHED, WANTED[0], {})
