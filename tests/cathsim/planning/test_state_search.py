"""The search of states: a chain from the aorta to the target, the same for a seed; what it did not find."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim import NavigateEnv
from cathsim.planning.state_search import StateSearchSettings, search_states

FEW = StateSearchSettings(steps=150)


def remaining(env: NavigateEnv, state: np.ndarray) -> float:
    env.simulation.restore(state)
    return env.task.remaining(env.phantom, env.simulation.tip_in_vessel)


@pytest.fixture(scope="module")
def env() -> NavigateEnv:
    return NavigateEnv("type_1", "bca", observation="tip", accuracy="fast")


def test_a_target_is_reached_by_states_that_an_episode_starts_from(env: NavigateEnv) -> None:
    found = search_states(env, np.random.default_rng(0))
    assert found.reached
    assert found.steps <= StateSearchSettings().steps
    ways = [remaining(env, state) for state in found.states]
    assert ways[0] > 0.06  # in the aorta, before the branch
    assert ways[-1] == pytest.approx(found.nearest, abs=1e-6)
    env.reset(seed=0, options={"start": found.states[-1]})
    assert np.linalg.norm(env.simulation.tip_in_vessel - env.goal) < env.task.success_radius


def test_same_generator_same_states(env: NavigateEnv) -> None:
    one, again, other = (search_states(env, np.random.default_rng(seed), settings=FEW) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.states, again.states)
    assert one.steps == again.steps
    assert other.states.shape != one.states.shape or not np.array_equal(other.states, one.states)


def test_what_is_not_reached_ends_at_the_nearest(env: NavigateEnv) -> None:
    far = NavigateEnv("type_1", "bca", observation="tip", accuracy="fast", success_radius=1e-4)
    found = search_states(far, np.random.default_rng(0), settings=FEW)
    assert not found.reached
    assert FEW.steps <= found.steps < FEW.steps + 40
    assert remaining(far, found.states[-1]) == pytest.approx(found.nearest, abs=1e-6)


def test_two_devices_are_both_moved() -> None:
    env = NavigateEnv("type_1", "lcca", catheter="vertebral", observation="tip", accuracy="fast")
    found = search_states(env, np.random.default_rng(0), settings=FEW)
    leads = []
    for state in found.states:
        env.simulation.restore(state)
        leads.append(env.simulation.device_lead)
    assert len(found.states) > 1
    assert np.ptp(leads) > 1e-3
