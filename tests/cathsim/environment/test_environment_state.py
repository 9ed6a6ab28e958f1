"""Saving an environment in the middle of an episode, and starting an episode from a saved state of the wire."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim import NavigateEnv


def drive(environment: NavigateEnv, actions: np.ndarray) -> list[tuple]:
    return [environment.step(action)[:4] for action in actions]


@pytest.fixture
def environment() -> NavigateEnv:
    return NavigateEnv(observation=("joints", "sequential", "force"), reward="geodesic", start_rotation=np.pi)


@pytest.fixture
def actions() -> np.ndarray:
    return np.random.default_rng(0).uniform((-0.2, -1.0), 1.0, (60, 2))


def test_episode_starts_where_a_wire_was_left(environment: NavigateEnv, actions: np.ndarray) -> None:
    environment.reset(seed=3)
    drive(environment, actions[:30])
    tip, start = environment.simulation.tip, environment.simulation.state()
    environment.reset(seed=4)
    _, info = environment.reset(options={"start": start})
    assert np.array_equal(info["tip"], tip)
    assert environment.steps == 0
    assert info["force"] == 0.0


def test_unknown_option_and_wrong_start_are_refused(environment: NavigateEnv) -> None:
    with pytest.raises(ValueError, match="reset knows no option where; there are start, target"):
        environment.reset(options={"where": 1})
    with pytest.raises(ValueError, match="expected a state of shape"):
        environment.reset(options={"start": np.zeros(3)})
