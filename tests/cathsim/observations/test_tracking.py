"""Tracked points in one view: spacing, memory, range, state."""

import numpy as np
import pytest

from cathsim.environment import NavigateEnv
from cathsim.observations.tracking import POINTS, SPACING, in_view, viewed_range


@pytest.fixture
def environment(type_1) -> NavigateEnv:
    environment = NavigateEnv(type_1, "lcca", observation="tracking")
    environment.reset(seed=1)
    return environment


def places(observation: np.ndarray, phantom) -> np.ndarray:
    low, high = viewed_range(phantom)
    return low + (observation[:14].reshape(7, 2) + 1) / 2 * (high - low)


def test_the_view_is_turned_towards_the_left() -> None:
    left, back, up = in_view(np.eye(3))
    assert left == pytest.approx([np.cos(np.radians(25)), 0])
    assert back == pytest.approx([np.sin(np.radians(25)), 0])
    assert up == pytest.approx([0, 1])


def test_points_lie_on_the_wire_two_millimetres_apart(environment: NavigateEnv, type_1) -> None:
    for _ in range(20):
        observation, *_ = environment.step(np.array([1.0, 0.3]))
    seen = places(observation, type_1)
    assert seen[0] == pytest.approx(in_view(environment.simulation.tip), abs=1e-6)
    assert np.linalg.norm(np.diff(seen[:POINTS], axis=0), axis=1) == pytest.approx(SPACING, rel=0.05)
    assert seen[6] == pytest.approx(in_view(environment.goal), abs=1e-6)
    assert observation[14:] == pytest.approx([1.0, 0.3])
    assert np.abs(observation).max() <= 1


def test_it_remembers_the_step_before(environment: NavigateEnv, type_1) -> None:
    start = environment.observe()
    assert start[:6] == pytest.approx(start[6:12])
    assert (start[14:] == 0).all()
    before = environment.step(np.array([1.0, 0.0]))[0]
    after = environment.step(np.array([1.0, 0.0]))[0]
    assert after[6:12] == pytest.approx(before[:6])


def test_state_keeps_it(environment: NavigateEnv) -> None:
    environment.step(np.array([1.0, 0.5]))
    state, expected = environment.state(), environment.observe()
    environment.step(np.array([-1.0, 0.5]))
    assert (environment.restore(state) == expected).all()
