"""Retrying: the first attempt is the controller's own, then devices are drawn back and the next one begins anew."""

from typing import Any

import gymnasium
import numpy as np
import pytest

from enn.retrying import WITHIN, RetryingController

FORWARDS = np.array([1.0, 0.2], np.float32)


class _Feeders:
    """Feeders alone: full actions are 2 mm."""

    def __init__(self, count: int) -> None:
        self.places = np.full(count, 0.001)

    @property
    def info(self) -> dict[str, float]:
        return dict(zip(("insertion", "catheter_insertion"), self.places.tolist(), strict=False))

    def step(self, action: np.ndarray) -> None:
        self.places += 0.002 * action[::2]


@pytest.mark.parametrize("feeders", [1, 2])
def test_devices_are_drawn_back_between_attempts(feeders: int) -> None:
    robot, made = _Feeders(feeders), []
    actions = np.tile(FORWARDS, feeders)
    actions[::2] = np.arange(1, feeders + 1) / feeders  # a catheter further in than the wire
    began: list[np.ndarray] = []

    def attempt(seed: int) -> Any:
        made.append(seed)
        began.append(robot.places.copy())
        return lambda observation, info: actions

    controller = RetryingController(attempt, 20, seed=7)
    seen = []
    for _ in range(120):
        seen.append(controller(None, robot.info))
        robot.step(seen[-1])
    assert controller.attempts >= 3
    assert made[0] == 7
    assert len(set(made)) == controller.attempts
    assert all((np.abs(place - 0.001) <= WITHIN + 1e-12).all() for place in began)
    assert all(np.array_equal(action, actions) for action in seen[:20])
    back = seen[20]
    assert (back[::2] == -1).all()
    assert (np.abs(back[1::2]) <= 1).all()
    assert (back[1::2] != 0).all()


def test_an_environments_devices_come_back_to_the_sheath() -> None:
    environment = gymnasium.make("cathsim:cathsim/Navigate-v0", catheter="simmons2", observation="tip", max_steps=400)
    observation, info = environment.reset(seed=0)
    insertions = [info["insertion"]]
    actions = np.tile(FORWARDS, environment.action_space.shape[0] // 2)  # type: ignore[index]
    controller = RetryingController(lambda seed: lambda observation, info: actions, 40)
    for _ in range(100):
        observation, _, _, _, info = environment.step(controller(observation, info))
        insertions.append(info["insertion"])
    environment.close()
    assert controller.attempts == 2
    assert max(insertions) > 0.06
    assert min(insertions[41:]) < insertions[0] + 2 * WITHIN
    assert insertions[-1] > 0.01  # on its way again
