"""Perturbed controller: a policy's actions mixed with correlated noise."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest

from enn.imitation.perturbed_controller import CORRELATION, PerturbedController

REPEAT = 3


def policy(action: tuple[float, float] = (0.5, -0.5)) -> Any:
    """Always says the same, and counts how often it is asked."""
    asked: list[Any] = []

    def act_batch(observations: dict[str, np.ndarray]) -> np.ndarray:
        asked.append(observations)
        return np.array([action], np.float32)

    space = gymnasium.spaces.Box(-1, 1, (2,), np.float32)
    return SimpleNamespace(action_space=space, keys=("tip",), action_repeat=REPEAT, act_batch=act_batch, asked=asked)


def actions(seed: int, steps: int, steered: Any) -> np.ndarray:
    controller = PerturbedController(steered, np.random.default_rng(seed))
    return np.array([controller({"tip": np.zeros(3), "other": np.zeros(1)}) for _ in range(steps)])


def test_each_action_is_held_and_the_policy_sees_its_own_keys() -> None:
    steered = policy()
    taken = actions(0, 4 * REPEAT, steered).reshape(4, REPEAT, 2)
    assert (taken == taken[:, :1]).all()
    assert len(np.unique(taken[:, 0, 0])) == 4
    assert [list(one) for one in steered.asked] == [["tip"]] * 4
    assert steered.asked[0]["tip"].shape == (1, 3)


def test_actions_are_the_mixture_of_advice_and_correlated_noise() -> None:
    generator = np.random.default_rng(5)
    share, noise = generator.uniform(), generator.normal(0.0, 1.0, 2)
    for action in actions(5, 5 * REPEAT, policy())[::REPEAT]:
        noise = CORRELATION * noise + np.sqrt(1 - CORRELATION**2) * generator.normal(0.0, 1.0, 2)
        expected = np.clip((1 - share) * np.array([0.5, -0.5], np.float32) + share * noise, -1, 1)
        assert action == pytest.approx(expected, abs=1e-6)


def test_shares_go_from_the_policy_alone_to_noise_alone() -> None:
    away = [float(np.abs(actions(seed, 60, policy()) - (0.5, -0.5)).mean()) for seed in range(40)]
    assert min(away) < 0.05
    assert max(away) > 0.6
