"""Reset bank: simulation states along successful episodes, from which later training episodes may start."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


class ResetBank:
    """States along demonstrations and own successes; a share of the resets starts from one of them.

    A start half-way to the target shows the goal's reward long before the policy finds it from the sheath. The oldest
    states make room for new ones.

    Args:
        share: probability that `draw` gives a state, once there is one; from 0 to 1.
        capacity: number of states kept.
        seed: of the draws.

    Raises:
        ValueError: a share outside 0 to 1, or a capacity below 1.
    """

    def __init__(self, share: float = 0.5, capacity: int = 4096, seed: int = 0) -> None:
        if not 0.0 <= share <= 1.0:
            raise ValueError(f"a bank's share must lie between 0 and 1, got {share}")
        if capacity < 1:
            raise ValueError(f"a bank's capacity must be at least 1, got {capacity}")
        self.share, self.capacity = share, capacity
        self._generator = np.random.default_rng(seed)
        self._states: NDArray[np.float64] | None = None
        self._count = self._next = 0

    def __len__(self) -> int:
        """Number of states there are."""
        return self._count

    def add_episode(self, states: NDArray[Any]) -> None:
        """Adds the states of an episode that reached the target.

        Args:
            states: shape (T, n); every row one that `env.reset(options={"start": row})` takes.

        Raises:
            ValueError: another number of dimensions, another size of state than before, or values that are not finite.
        """
        states = np.asarray(states, np.float64)
        if states.ndim != 2:
            raise ValueError(f"expected states of shape (T, n), got {states.shape}")
        if not np.isfinite(states).all():
            raise ValueError("the states of an episode must be finite: leave this episode out of the bank")
        if self._states is None:
            self._states = np.zeros((self.capacity, states.shape[1]))
        if states.shape[1] != self._states.shape[1]:
            raise ValueError(
                f"the bank keeps states of {self._states.shape[1]} values, got {states.shape[1]}: these episodes are "
                "of another wire or environment"
            )
        states = states[-self.capacity :]
        rows = (self._next + np.arange(len(states))) % self.capacity
        self._states[rows] = states
        self._next = int((self._next + len(states)) % self.capacity)
        self._count = min(self._count + len(states), self.capacity)

    def draw(self) -> NDArray[np.float64] | None:
        """A state to start from, or None: start as the task says. Shape (n,)."""
        if self._states is None or self._count == 0 or self._generator.random() >= self.share:
            return None
        return self._states[self._generator.integers(self._count)].copy()

    def choose(self) -> int | None:
        """The case of an episode that starts as the task says; None: as the environment draws it."""
        return None

    def judge(self, case: int, *, success: bool) -> None:
        """Takes note of how an episode ended that started as the task says."""

    def state(self) -> dict[str, Any]:
        """Contents and random state, as plain data; for `restore`."""
        return {
            "states": None if self._states is None else self._states[: self._count].copy(),
            "next": self._next,
            "generator": self._generator.bit_generator.state,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Returns to a state of a bank with the same capacity.

        Raises:
            ValueError: the state holds more than fits.
        """
        states = state["states"]
        self._states, self._count, self._next = None, 0, state["next"]
        self._generator.bit_generator.state = state["generator"]
        if states is None:
            return
        if len(states) > self.capacity:
            raise ValueError(f"the saved bank holds {len(states)} states, more than the capacity of {self.capacity}")
        self._states = np.zeros((self.capacity, states.shape[1]))
        self._states[: len(states)] = states
        self._count = len(states)
