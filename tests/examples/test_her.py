"""The example of hindsight experience replay: it trains with relabelled goals, and its rewards agree with them."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from stable_baselines3 import SAC, HerReplayBuffer

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "her.py"


@pytest.fixture(scope="module")
def example() -> ModuleType:
    spec = importlib.util.spec_from_file_location("example_her", EXAMPLE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_goals_are_relabelled(example: ModuleType) -> None:
    env = example.make_env()
    model = SAC("MultiInputPolicy", env, replay_buffer_class=HerReplayBuffer, learning_starts=110, seed=0)
    model.learn(130)
    sample = model.replay_buffer.sample(200)
    goals = sample.observations["desired_goal"].numpy()
    reached = sample.next_observations["achieved_goal"].numpy()
    rewards = sample.rewards.numpy().ravel()
    near = np.linalg.norm(goals - reached, axis=1) <= 0.008
    assert np.array_equal(rewards, np.where(near, 0.0, -1.0))
    assert (rewards == 0.0).sum() > 20, "only relabelled goals are reached that early"
    env.close()


def test_the_example_runs(example: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(example, "HELD_OUT", range(10_000, 10_001))
    before, after = example.main(520, seed=0)
    assert {before, after} <= {0, 1}
