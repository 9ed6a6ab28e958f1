"""A point in a square instead of a wire in an aorta: learnt in seconds, with everything that a training touches."""

import os
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import gymnasium
import numpy as np
import pytest

from enn.exploration import Samples
from tests.enn.rod import drawn


class PointEnv(gymnasium.Env):
    """A point that is to reach the centre of a square; it can be saved, restored and started anywhere."""

    action_space = gymnasium.spaces.Box(-1, 1, (2,), np.float32)

    def __init__(self, keys: tuple[str, ...] = ("place",), max_steps: int = 40, broken_at: int | None = None) -> None:
        box = gymnasium.spaces.Box
        spaces = {
            "place": box(-np.inf, np.inf, (2,), np.float32),
            "range": box(-np.inf, np.inf, (3,), np.float32),
            "image": box(0, 255, (1, 36, 36), np.uint8),
            "mask": box(0, 255, (1, 36, 36), np.uint8),
        }
        self.keys, self.max_steps, self.broken_at = keys, max_steps, broken_at
        self.observation_space = gymnasium.spaces.Dict([(key, spaces[key]) for key in keys])
        self.place, self.steps = np.zeros(2), 0

    def _observe(self) -> dict[str, np.ndarray]:
        mask = np.zeros((1, 36, 36), np.uint8)
        row, column = np.clip(((self.place + 1) * 18).astype(int), 0, 35)
        mask[0, row, column] = 255
        everything = {
            "place": self.place.astype(np.float32),
            "range": np.array([*self.place, np.linalg.norm(self.place)], np.float32),
            "image": mask // 2 + 30,
            "mask": mask,
        }
        if self.broken_at is not None and self.steps >= self.broken_at:
            everything["place"] = np.full(2, np.nan, np.float32)
        return {key: everything[key] for key in self.keys}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.place = np.array(options["start"]) if options else self.np_random.uniform(-1, 1, 2)
        self.steps = 0
        return self._observe(), {"tip": np.append(self.place, 0.0)}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        before = np.linalg.norm(self.place)
        self.place = np.clip(self.place + 0.15 * np.asarray(action, float), -1, 1)
        self.steps += 1
        distance = float(np.linalg.norm(self.place))
        success = distance < 0.1
        reward = float(10 * (before - distance) - 0.1 + 10 * success)
        info = {"tip": np.append(self.place, 0.0), "force": 0.1 * distance, "success": success}
        return self._observe(), reward, success, not success and self.steps >= self.max_steps, info

    def start_state(self) -> np.ndarray:
        return self.place.copy()

    def state(self) -> dict[str, Any]:
        return {"place": self.place.copy(), "steps": self.steps, "generator": self.np_random.bit_generator.state}

    def restore(self, state: dict[str, Any]) -> Any:
        self.place, self.steps = state["place"].copy(), state["steps"]
        self.np_random.bit_generator.state = state["generator"]
        return self._observe()


@pytest.fixture
def point_env() -> type[PointEnv]:
    """The class of the toy environment."""
    return PointEnv


@pytest.fixture(scope="session")
def samples() -> Samples:
    """Scripted samples of the rod; treated as read-only."""
    return drawn()
