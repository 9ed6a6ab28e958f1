"""A point to be steered to the middle of a picture: a task that imitation learns in a second."""

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

SIDE = 40
_STEP, _REACH = 3.0, 2.5  # px


class DrawnPoint(gymnasium.Env[Any, Any]):
    """A bright blob that moves by up to three pixels a step; the middle of the image is its target."""

    def __init__(self) -> None:
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.observation_space = gymnasium.spaces.Dict(
            {
                "image": gymnasium.spaces.Box(0, 255, (1, SIDE, SIDE), np.uint8),
                "place": gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float32),
            }
        )
        self.place, self.steps = np.zeros(2), 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.place, self.steps = self.np_random.uniform(-16, 16, 2), 0
        return self._observation(), self._info()

    def step(self, action: NDArray[Any]) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.place = np.clip(self.place + _STEP * np.asarray(action), -18, 18)
        self.steps += 1
        reached = bool(np.abs(self.place).max() < _REACH)
        return self._observation(), 0.0, reached, self.steps >= 20 and not reached, self._info()

    def _observation(self) -> dict[str, NDArray[Any]]:
        grid = np.arange(SIDE) - (SIDE - 1) / 2
        away = (grid[:, None] - self.place[0]) ** 2 + (grid[None, :] - self.place[1]) ** 2
        return {"image": (200 * np.exp(-away / 8)).astype(np.uint8)[None], "place": self.place.astype(np.float32)}

    def _info(self) -> dict[str, Any]:
        return {"tip": np.append(self.place, 0.0), "force": float(np.abs(self.place).max()) / 18}


def expert(observation: Mapping[str, NDArray[Any]], info: Mapping[str, Any]) -> NDArray[np.float32]:
    """Goes straight to the middle."""
    return np.clip(-observation["place"] / _STEP, -1.0, 1.0).astype(np.float32)
