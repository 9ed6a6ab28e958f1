"""The history of an episode: recent moves, and the time since the tip last came nearer to the target."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from cathsim.simulation import CONTROL_STEP, Simulation

TIME_CONSTANTS = np.array([1.0, 4.0])  # s: time constants of the running means
PATIENCE = 8.0  # s without progress that count as long
BACK_SCALE, GAIN_SCALE, INSERTION_SCALE = 0.02, 0.01, 0.03  # m, m/s, m
PROGRESS = 1e-3  # m: a smaller gain does not count as progress
HISTORY_SIZE = 3 * len(TIME_CONSTANTS) + 5


class History:
    """Recent moves and progress of an episode, in a few numbers.

    One moment alone does not distinguish the first try at an ostium from the tenth: a policy with this history can try
    something else.

    Args:
        remaining: gives the way that remains from the tip to the target, m.
    """

    def __init__(self, simulation: Simulation, remaining: Callable[[], float]) -> None:
        self.simulation, self._remaining_way = simulation, remaining
        self._forget = np.exp(-CONTROL_STEP / TIME_CONSTANTS)
        self.begin()

    def begin(self) -> None:
        """Starts with the present moment."""
        self._moves, self._gain = np.zeros((len(TIME_CONSTANTS), 2)), np.zeros(len(TIME_CONSTANTS))
        self._remaining = self._best = self._remaining_way()
        self._waited = 0.0
        self._insertion, self._rotation = self.simulation.insertion, self.simulation.rotation

    def advance(self, translation: float, rotation: float) -> None:
        """Records a control step: the feeder's translation and rotation as shares of the largest, -1 to 1."""
        keep, now = self._forget, self._remaining_way()
        self._moves = keep[:, None] * self._moves + (1 - keep)[:, None] * (translation, rotation)
        self._gain = keep * self._gain + (1 - keep) * (self._remaining - now) / CONTROL_STEP
        self._remaining = now
        self._waited += CONTROL_STEP
        if now < self._best - PROGRESS:
            self._best, self._waited = now, 0.0
            self._insertion, self._rotation = self.simulation.insertion, self.simulation.rotation

    def read(self) -> np.ndarray:
        """The history so far (11,), float32, all of the order of 1.

        Running means over 1 and 4 s of the feeder's translation and rotation as shares of the largest (4) and of the
        gain g on the target over 10 mm/s + |g| (2); then, since the tip was nearest to the target along the lumen: the
        time t over 8 s + t, the hyperbolic tangent of the way lost over 20 mm, that of the insertion since over
        30 mm, cosine and sine of the feeder's rotation since (5).
        """
        turned = self.simulation.rotation - self._rotation
        fed = self.simulation.insertion - self._insertion
        return np.concatenate(
            (
                self._moves.ravel(),
                self._gain / (GAIN_SCALE + np.abs(self._gain)),
                (self._waited / (PATIENCE + self._waited), np.tanh((self._remaining - self._best) / BACK_SCALE)),
                (np.tanh(fed / INSERTION_SCALE), np.cos(turned), np.sin(turned)),
            )
        ).astype(np.float32)

    def state(self) -> dict[str, Any]:
        """All of it, to be pickled; for `restore`."""
        return {
            "moves": self._moves.copy(),
            "gain": self._gain.copy(),
            "at": (self._remaining, self._best, self._waited, self._insertion, self._rotation),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Returns to a saved moment."""
        self._moves, self._gain = state["moves"].copy(), state["gain"].copy()
        self._remaining, self._best, self._waited, self._insertion, self._rotation = state["at"]
