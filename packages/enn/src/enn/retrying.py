"""Retrying controller: where an attempt takes too long, devices are drawn back and turned, and try again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Controller = Callable[[Any, Mapping[str, Any]], NDArray[np.float32]]  # observation, info -> action

INSERTIONS = ("insertion", "catheter_insertion")  # of the feeders, in `info`, m
WITHIN = 1e-3  # m of where they began: drawn back far enough


class RetryingController:
    """Attempts at one episode; call `reset()` at the start of each.

    Between two attempts every feeder goes back at full speed to where it was when the episode began, while it turns at
    a speed that is drawn once: the next attempt begins with the bend pointing elsewhere.

    Args:
        attempt: makes the controller of an attempt, from its number; it is called before the attempt's first step.
        steps: of an attempt.
        seed: of the turns between attempts.

    Raises:
        ValueError: an attempt has no step.
    """

    def __init__(self, attempt: Callable[[int], Controller], steps: int, seed: int = 0) -> None:
        if steps < 1:
            raise ValueError(f"an attempt must have 1 step at least, got {steps}")
        self._attempt, self._steps, self._seed = attempt, steps, seed
        self.reset()

    def reset(self) -> None:
        """Starts an episode: the next call is the first of its first attempt."""
        self._generator = np.random.default_rng(self._seed)
        self._number = -1  # of the attempt
        self._left = 0  # steps of it
        self._controller: Controller | None = None
        self._turns: NDArray[np.float64] | None = None  # while feeders go back
        self._began: dict[str, float] = {}

    @property
    def attempts(self) -> int:
        """How many were begun."""
        return self._number + 1

    def __call__(self, observation: Any, info: Mapping[str, Any]) -> NDArray[np.float32]:
        """The action of this step. Shape (actions,): translation and rotation of each feeder.

        Args:
            info: of the environment, with the feeders' insertions.
        """
        there = {name: float(info[name]) for name in INSERTIONS if name in info}
        if not self._began:
            self._began = there
        if self._left == 0 and self._controller is not None:
            self._controller = None
            self._turns = self._generator.uniform(-1.0, 1.0, len(there))
        if self._turns is not None:
            inside = [there[name] > self._began[name] + WITHIN for name in there]
            if any(inside):
                pulled = zip(inside, self._turns, strict=True)
                back = [(-1.0, turn) if out else (0.0, 0.0) for out, turn in pulled]
                return np.array(back, np.float32).ravel()
            self._turns = None
        if self._controller is None:
            self._number += 1
            self._controller, self._left = self._attempt(self._number), self._steps
        self._left -= 1
        return self._controller(observation, info)
