"""The history of an episode: recent moves, and the time since the tip last came nearer to the target."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from cathsim.devices.simulation import DualSimulation
from cathsim.simulation import Simulation

TIME_CONSTANTS = np.array([1.0, 4.0])  # s: time constants of the running means
PATIENCE = 8.0  # s without progress that count as long
BACK_SCALE, GAIN_SCALE, INSERTION_SCALE = 0.02, 0.01, 0.03  # m, m/s, m
PROGRESS = 1e-3  # m: a smaller gain does not count as progress
HISTORY_SIZE = 3 * len(TIME_CONSTANTS) + 5  # with one device
_OF_CATHETER = 2 * len(TIME_CONSTANTS) + 3  # more with two


class History:
    """Recent moves and progress of an episode, in a few numbers.

    One moment alone does not distinguish the first try at an ostium from the tenth: a policy with this history can try
    something else.

    Args:
        remaining: gives the way that remains from the tip to the target, m.
    """

    def __init__(self, simulation: Simulation, remaining: Callable[[], float]) -> None:
        self.simulation, self._remaining_way = simulation, remaining
        self._pair = simulation if isinstance(simulation, DualSimulation) and simulation.pair.both else None
        self.size = HISTORY_SIZE + (_OF_CATHETER if self._pair else 0)
        self._forget = np.exp(-simulation.pace.interval / TIME_CONSTANTS)
        self.begin()

    def begin(self) -> None:
        """Starts with the present moment."""
        self._moves, self._gain = np.zeros((len(TIME_CONSTANTS), 4 if self._pair else 2)), np.zeros(len(TIME_CONSTANTS))
        self._remaining = self._best = self._remaining_way()
        self._waited = 0.0
        self._keep_place()

    def _keep_place(self) -> None:
        self._insertion, self._rotation = self.simulation.insertion, self.simulation.rotation
        self._catheter = self._catheter_place()

    def _catheter_place(self) -> tuple[float, float]:
        return self._pair.catheter_place() if self._pair else (0.0, 0.0)

    def advance(self, *moves: float) -> None:
        """Records a control step: translation and rotation of each feeder as shares of the largest, -1 to 1."""
        keep, now, interval = self._forget, self._remaining_way(), self.simulation.pace.interval
        self._moves = keep[:, None] * self._moves + (1 - keep)[:, None] * moves
        self._gain = keep * self._gain + (1 - keep) * (self._remaining - now) / interval
        self._remaining = now
        self._waited += interval
        if now < self._best - PROGRESS:
            self._best, self._waited = now, 0.0
            self._keep_place()

    def read(self) -> np.ndarray:
        """The history so far (11,), with two devices (18,), float32, all of the order of 1.

        Running means over 1 and 4 s of each feeder's translation and rotation as shares of the largest (4 or 8) and of
        the gain g on the target over 10 mm/s + |g| (2); then, since the tip was nearest to the target along the lumen:
        the time t over 8 s + t, the hyperbolic tangent of the way lost over 20 mm, that of the insertion since over
        30 mm, cosine and sine of the feeder's rotation since (5); with two devices, the last three of the catheter (3).
        """
        turned = self.simulation.rotation - self._rotation
        fed = self.simulation.insertion - self._insertion
        return np.concatenate(
            (
                self._moves.ravel(),
                self._gain / (GAIN_SCALE + np.abs(self._gain)),
                (self._waited / (PATIENCE + self._waited), np.tanh((self._remaining - self._best) / BACK_SCALE)),
                (np.tanh(fed / INSERTION_SCALE), np.cos(turned), np.sin(turned)),
                self._of_catheter(),
            )
        ).astype(np.float32)

    def _of_catheter(self) -> tuple[float, ...]:
        if self._pair is None:
            return ()
        fed, turned = (now - then for now, then in zip(self._catheter_place(), self._catheter, strict=True))
        return float(np.tanh(fed / INSERTION_SCALE)), math.cos(turned), math.sin(turned)

    def state(self) -> dict[str, Any]:
        """All of it, to be pickled; for `restore`."""
        return {
            "moves": self._moves.copy(),
            "gain": self._gain.copy(),
            "at": (self._remaining, self._best, self._waited, self._insertion, self._rotation),
            "catheter": self._catheter,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Returns to a saved moment."""
        self._moves, self._gain = state["moves"].copy(), state["gain"].copy()
        self._remaining, self._best, self._waited, self._insertion, self._rotation = state["at"]
        self._catheter = state["catheter"]
