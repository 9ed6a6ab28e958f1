"""A rod that is fed and turned in a plane: scripted samples of it, and encoders fitted to them, made once."""

import functools
from typing import Any

import gymnasium
import numpy as np

from enn.encoder import Encoder, EncoderSettings, Samples, fit_encoder, scripted_samples
from enn.exploration import TRUTH

SIZE = 32
QUICK = EncoderSettings(hidden=32, features=12, epochs=6, batch_size=25, learning_rate=4e-3)
ARRAYS = dict[str, np.ndarray]


class Rod(gymnasium.Env[ARRAYS, np.ndarray]):
    """A straight rod in a plane, fed up and turned; drawn dark on a grey ramp. Ends after 30 steps."""

    action_space = gymnasium.spaces.Box(-1, 1, (2,), np.float32)

    def __init__(self, names: tuple[str, ...] = ("image", "mask", "joints", *TRUTH)) -> None:
        box = gymnasium.spaces.Box
        spaces = {
            "image": box(0, 255, (1, SIZE, SIZE), np.uint8),
            "mask": box(0, 255, (1, SIZE, SIZE), np.uint8),
            "joints": box(-np.inf, np.inf, (4,), np.float32),
            "shape": box(-np.inf, np.inf, (5, 3), np.float32),
            "feeder": box(-np.inf, np.inf, (3,), np.float32),
            "force": box(-np.inf, np.inf, (3,), np.float32),
        }
        self.observation_space = gymnasium.spaces.Dict({name: spaces[name] for name in names})

    def _observe(self) -> ARRAYS:
        heading = np.array((np.sin(self.angle), 0.0, np.cos(self.angle)))
        tip = (0.01 + self.length) * heading
        shape = tip - np.linspace(0, 0.08, 5)[:, None] * heading
        along = np.linspace(0, 1, 60)[:, None] * tip
        columns = np.clip(16 + along[:, 0] / 0.002, 0, SIZE - 1).astype(int)
        rows = np.clip(28 - along[:, 2] / 0.002, 0, SIZE - 1).astype(int)
        image = np.tile(np.linspace(100, 200, SIZE), (SIZE, 1))
        mask = np.zeros((SIZE, SIZE))
        image[rows, columns] -= 40
        mask[rows, columns] = 255
        everything = {
            "image": image[None].astype(np.uint8),
            "mask": mask[None].astype(np.uint8),
            "joints": np.array((self.length, self.turns, self.angle, 0), np.float32),
            "shape": shape.astype(np.float32),
            "feeder": np.array((self.length, np.cos(self.turns), np.sin(self.turns)), np.float32),
            "force": np.zeros(3, np.float32),
        }
        return {name: everything[name] for name in self.observation_space.spaces}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[ARRAYS, dict[str, Any]]:
        super().reset(seed=seed)
        start = (options or {}).get("start")
        self.length, self.angle = (0.02, 0.0) if start is None else start
        self.turns, self.steps = 0.0, 0
        return self._observe(), {}

    def start_state(self) -> np.ndarray:
        return np.array((self.length, self.angle))

    def step(self, action: np.ndarray) -> tuple[ARRAYS, float, bool, bool, dict[str, Any]]:
        self.length = float(np.clip(self.length + 0.002 * action[0], 0, 0.04))
        self.angle = float(np.clip(self.angle + 0.05 * action[1], -0.7, 0.7))
        self.turns += 0.3 * float(action[1])
        self.steps += 1
        return self._observe(), 0.0, False, self.steps >= 30, {}


class SleevedRod(Rod):
    """The rod in a sleeve that is fed by two further actions: its feeder tells of both, and by how much it is ahead."""

    action_space = gymnasium.spaces.Box(-1, 1, (4,), np.float32)

    def __init__(self, names: tuple[str, ...] = ("image", "mask", "joints", *TRUTH)) -> None:
        super().__init__(names)
        self.observation_space["feeder"] = gymnasium.spaces.Box(-np.inf, np.inf, (7,), np.float32)

    def _observe(self) -> ARRAYS:
        seen = super()._observe()
        more = self.sleeve, np.cos(self.sleeve_turns), np.sin(self.sleeve_turns), self.length - self.sleeve
        return seen | {"feeder": np.array((*seen["feeder"], *more), np.float32)}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[ARRAYS, dict[str, Any]]:
        self.sleeve = self.sleeve_turns = 0.0
        return super().reset(seed=seed, options=options)

    def step(self, action: np.ndarray) -> tuple[ARRAYS, float, bool, bool, dict[str, Any]]:
        self.sleeve = float(np.clip(self.sleeve + 0.002 * action[2], 0, 0.04))
        self.sleeve_turns += 0.3 * float(action[3])
        return super().step(action[:2])


@functools.cache
def drawn() -> Samples:
    return scripted_samples(Rod, 1000, seed=0)


@functools.cache
def fitted(*keys: str) -> tuple[Encoder, dict[str, Any]]:
    return fit_encoder(drawn(), keys, QUICK)
