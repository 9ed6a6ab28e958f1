"""Evaluation episodes: the same for the same seeds."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from enn.reinforcement.evaluation import run_episodes
from enn.reinforcement.training import (
    Training,
)
from tests.enn.reinforcement.small_training import SMALL


def test_evaluation_is_the_same_for_the_same_seeds(point_env: Any) -> None:
    result = Training(dataclasses.replace(SMALL, decisions=800, evaluate_every=800), point_env, None, seed=1).run()
    assert result.evaluation is not None
    for count in (1, 3):  # environments side by side
        again = run_episodes(
            result.policy, [point_env() for _ in range(count)], range(501_000, 501_005), deterministic=True
        )
        assert (again.success, again.steps) == (result.evaluation["success"], result.evaluation["steps"])
        assert again.path_mm == pytest.approx(result.evaluation["path_mm"])
    drawn = run_episodes(result.policy, [point_env()], range(9), deterministic=False)
    assert drawn == run_episodes(result.policy, [point_env()], range(9), deterministic=False)
    assert drawn != run_episodes(result.policy, [point_env()], range(9), deterministic=True)
