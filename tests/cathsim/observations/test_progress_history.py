"""The history of an episode: what it counts as progress, what it forgets, and that it goes on where it was saved."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim.environment import NavigateEnv
from cathsim.observations.progress_history import GAIN_SCALE, HISTORY_SIZE, PATIENCE, TIME_CONSTANTS, History
from cathsim.robot.pace import PACES
from cathsim.simulation import CONTROL_STEP

FORWARD = np.array([1.0, 0.2])
KEYS = ("history", "tip")


@pytest.fixture
def environment(make_env) -> NavigateEnv:
    return make_env(target="lcca", observation=KEYS, start_rotation=np.pi)


def test_an_episode_begins_without_a_past(environment: NavigateEnv) -> None:
    seen = environment.reset(seed=0)[0]["history"]
    assert seen.shape == (HISTORY_SIZE,)
    assert seen.dtype == np.float32
    expected = np.zeros(HISTORY_SIZE)
    expected[-2] = 1.0  # the cosine of no rotation
    np.testing.assert_allclose(seen, expected, atol=1e-7)
    for _ in range(20):
        environment.step(FORWARD)
    np.testing.assert_allclose(environment.reset(seed=0)[0]["history"], expected, atol=1e-7)


def test_means_follow_the_actions(environment: NavigateEnv) -> None:
    environment.reset(seed=0)
    for _ in range(10):
        seen = environment.step(FORWARD)[0]["history"]
    share = 1 - np.exp(-10 * CONTROL_STEP / TIME_CONSTANTS)
    np.testing.assert_allclose(seen[:4].reshape(2, 2), share[:, None] * FORWARD, atol=1e-6)
    gained = share * 0.018  # m/s: the way ahead is free, so nearly what is fed
    np.testing.assert_allclose(seen[4:6], gained / (GAIN_SCALE + gained), rtol=0.15)


def test_waiting_counts_from_the_best_place(environment: NavigateEnv) -> None:
    environment.reset(seed=0)
    for _ in range(20):
        environment.step(FORWARD)
    assert environment.observe()["history"][6] < 0.05
    for _ in range(15):
        seen = environment.step(np.array([-1.0, 0.5]))[0]["history"]
    waited = 15 * CONTROL_STEP
    assert seen[6] == pytest.approx(waited / (PATIENCE + waited), abs=0.02)
    assert seen[7] > 0.5  # nearly 30 mm further away
    assert seen[8] < -0.5
    turned = 15 * 0.5 * np.radians(15)
    np.testing.assert_allclose(seen[9:], (np.cos(turned), np.sin(turned)), atol=0.1)


def test_a_small_gain_is_no_progress() -> None:
    class Still:
        insertion = rotation = 0.0
        pace = PACES["usual"]

    ways = iter((0.100, 0.0995, 0.0985))
    history = History(Still(), lambda: next(ways))  # type: ignore[arg-type]
    history.advance(0.1, 0.0)
    assert history.read()[6] > 0
    history.advance(0.1, 0.0)
    assert history.read()[6] == 0


def test_state_keeps_it(environment: NavigateEnv) -> None:
    environment.reset(seed=3)
    for _ in range(12):
        environment.step(FORWARD)
    state = environment.state()
    after = environment.step(FORWARD)[0]["history"]
    environment.reset(seed=4)
    environment.restore(state)
    np.testing.assert_array_equal(environment.step(FORWARD)[0]["history"], after)


def test_needs_a_target(environment: NavigateEnv) -> None:
    from cathsim.observations.observables import make_observable

    with pytest.raises(ValueError, match="'history' needs a target"):
        make_observable("history", environment.simulation, environment.fluoroscope, None, environment.roadmap)
