"""An environment that costs nothing, so that a measured time is the learning's alone."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np


class Blank(gymnasium.Env[Any, Any]):
    """Gives one random observation of a space, for ever; takes actions of any number of values in [-1, 1]."""

    def __init__(self, observation_space: gymnasium.spaces.Space[Any], actions: int) -> None:
        self.action_space = gymnasium.spaces.Box(-1, 1, (actions,), np.float32)
        self.observation_space = observation_space
        self._observation = observation_space.sample()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        return self._observation, {}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        return self._observation, 0.0, False, False, {}
