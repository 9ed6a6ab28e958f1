"""Environments that are only looked at where an action ends: fewer observations, the same ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cathsim import NavigateEnv
from cathsim.many_anatomies import NavigateManyEnv
from tests.cathsim.equal_observations import same

KEYS = ("roadmap", "history", "image", "joints", "sequential", "tracking", "force")
STEPS = 14


def episode(environment: Any, actions: np.ndarray) -> list[tuple[Any, float, bool, bool]]:
    observation, _ = environment.reset(seed=3)
    rows = [(observation, 0.0, False, False)]
    for action in actions:
        observation, reward, terminated, truncated, _ = environment.step(action)
        rows.append((observation, reward, terminated, truncated))
        if terminated or truncated:
            break
    return rows


def environment(**changed: Any) -> NavigateEnv:
    task = {"reward": "geodesic", "max_steps": STEPS}
    return NavigateEnv("type_1", "bca", observation=KEYS, accuracy="fast", **task, **changed)


def test_what_is_observed_is_what_is_observed_at_every_step() -> None:
    actions = np.random.default_rng(0).uniform(-1, 1, (STEPS, 2))
    every, third = (episode(environment(observe_every=number), actions) for number in (1, 3))
    assert len(every) == len(third) == STEPS + 1
    for step, (one, other) in enumerate(zip(every, third, strict=True)):
        assert one[1:] == other[1:]
        if step % 3 == 0 or step == STEPS:  # the episode ends at 14, no multiple of 3
            assert same(one[0], other[0])
        else:
            assert other[0] is third[step - step % 3][0]


def test_it_starts_again_with_every_episode() -> None:
    tried = environment(observe_every=4)
    actions = np.random.default_rng(1).uniform(0, 1, (STEPS, 2))
    episode(tried, actions[:6])
    observation, _ = tried.reset(seed=8)
    expected, _ = environment().reset(seed=8)
    assert same(observation, expected)
    assert [tried.step(action)[0] is observation for action in actions[:4]] == [True, True, True, False]


def test_a_saved_moment_is_observed() -> None:
    tried, again = environment(observe_every=5), environment(observe_every=5)
    tried.reset(seed=1)
    for action in np.random.default_rng(2).uniform(0, 1, (7, 2)):
        tried.step(action)
    again.reset(seed=2)
    observation = again.restore(tried.state())
    assert same(observation, tried.observe())
    assert again.step(np.zeros(2))[0] is observation


def test_many_anatomies_take_it() -> None:
    many = NavigateManyEnv((0,), ("bca",), observation=("roadmap",), observe_every=2, resolution=1.5e-3)
    observation, _ = many.reset(seed=0)
    assert many.step(np.ones(2))[0] is observation
    assert many.step(np.ones(2))[0] is not observation


@pytest.mark.parametrize("number", [0, -3, 2.5])
def test_other_numbers_are_refused(number: object) -> None:
    with pytest.raises(ValueError, match="observe_every must"):
        environment(observe_every=number)
