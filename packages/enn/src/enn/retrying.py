"""Retrying controller: where an attempt takes too long, devices are withdrawn and try again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Controller = Callable[[Any, Mapping[str, Any]], NDArray[np.float32]]  # observation, info -> action

INSERTIONS = ("insertion", "catheter_insertion")  # of the feeders, in `info`, m
WITHIN = 1e-3  # m of where they began: withdrawn far enough
_BACK = 250  # steps in which 0.5 m are withdrawn at the usual pace, at most
_ANOTHER = 1_000_003  # between the seeds of an episode's attempts


def steps_of_attempts(steps: int, attempts: int) -> int:
    """Steps of an episode that leaves the time for attempts of `steps` each, and for going back between them."""
    return steps + (attempts - 1) * (steps + _BACK)


class RetryingController:
    """Attempts at one episode; call `reset()` at the start of each.

    Between two attempts every feeder goes back at full speed to where it was when the episode began, while it turns at
    a speed that is drawn once: the next attempt begins with the bend pointing elsewhere.

    Args:
        attempt: makes the controller of an attempt, from a seed of its own, which is `seed` for the first; it is called
            before the attempt's first step.
        steps: of an attempt.
        most: attempts; the last one goes on to the episode's end. None: any number.
        seed: of the attempts and of the turns between them.

    Raises:
        ValueError: an attempt has no step, or there is none.
    """

    def __init__(
        self, attempt: Callable[[int], Controller], steps: int, most: int | None = None, seed: int = 0
    ) -> None:
        if steps < 1 or (most is not None and most < 1):
            raise ValueError(f"there must be 1 attempt with 1 step at least, got {most} with {steps}")
        self._attempt, self._steps, self._most, self._seed = attempt, steps, most, seed
        self.reset()

    def reset(self) -> None:
        """Starts an episode: the next call is the first of its first attempt."""
        self._generator = np.random.default_rng(self._seed)
        self._controller: Controller | None = None
        self._number = -1  # of the attempt
        self._left = 0  # steps of it
        self._turns: NDArray[np.float64] | None = None  # while feeders go back
        self._began: dict[str, float] = {}

    @property
    def controller(self) -> Controller | None:
        """That of the present attempt, or of the last one while the devices go back; None before the first."""
        return self._controller

    @property
    def attempts(self) -> int:
        """How many were begun."""
        return self._number + 1

    def __call__(self, observation: Any, info: Mapping[str, Any]) -> NDArray[np.float32]:
        """The action of this step. Shape (actions,): translation and rotation of each feeder.

        Args:
            info: of the environment, with the feeders' insertions.
        """
        insertions = {name: float(info[name]) for name in INSERTIONS if name in info}
        if not self._began:
            self._began = insertions
        steering = self._controller is not None and self._turns is None
        if steering and self._left == 0 and self.attempts != self._most:
            self._turns = self._generator.uniform(-1.0, 1.0, len(insertions))
        if self._turns is not None:
            inside = [insertions[name] > self._began[name] + WITHIN for name in insertions]
            if any(inside):
                turns = zip(inside, self._turns, strict=True)
                back = [(-1.0, turn) if pulled else (0.0, 0.0) for pulled, turn in turns]
                return np.array(back, np.float32).ravel()
        if self._controller is None or self._turns is not None:
            self._number += 1
            own_seed = self._seed + _ANOTHER * self._number
            self._controller, self._left, self._turns = self._attempt(own_seed), self._steps, None
        self._left = max(self._left - 1, 0)
        return self._controller(observation, info)
