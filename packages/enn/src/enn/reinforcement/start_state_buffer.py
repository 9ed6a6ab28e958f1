"""Start-state buffers: simulation states along successful episodes, from which later training episodes may start."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from enn.trajectory import Trajectory

RECORD_EVERY = 3  # steps between the states that a successful episode leaves in a start-state buffer
LEAST_WEIGHT = 0.15  # of a case that is always solved; one that never is has 1 more
EARLIER_WEIGHT = 0.5  # of a case's earlier episodes beside its latest


class StartStateBuffer:
    """Keeps states along demonstrations and own successes; a share of the resets starts from one of them.

    A start half-way to the target shows the goal's reward long before the policy finds it from the sheath. New states
    replace the oldest ones.

    Args:
        share: probability that `draw` gives a state, once there is one; from 0 to 1.

    Raises:
        ValueError: a share outside 0 to 1, or a capacity below 1.
    """

    def __init__(self, share: float = 0.5, capacity: int = 4096, seed: int = 0) -> None:
        if not 0.0 <= share <= 1.0:
            raise ValueError(f"a start-state buffer's share must lie between 0 and 1, got {share}")
        if capacity < 1:
            raise ValueError(f"a start-state buffer's capacity must be at least 1, got {capacity}")
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
            raise ValueError(
                "the states of an episode must be finite: leave this episode out of the start-state buffer"
            )
        if self._states is None:
            self._states = np.zeros((self.capacity, states.shape[1]))
        if states.shape[1] != self._states.shape[1]:
            raise ValueError(
                f"the start-state buffer keeps states of {self._states.shape[1]} values, got {states.shape[1]}: these "
                "episodes are of another wire or environment"
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

    def choose_case(self) -> int | None:
        """The case of an episode that starts as the task says; None: the environment draws it."""
        return None

    def record_outcome(self, case: int, *, success: bool) -> None:
        """Records how an episode ended that started as the task says."""

    def state(self) -> dict[str, Any]:
        """Contents and random state, as plain data; for `restore`."""
        return {
            "states": None if self._states is None else self._states[: self._count].copy(),
            "next": self._next,
            "generator": self._generator.bit_generator.state,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Returns to a saved start-state buffer of the same capacity.

        Raises:
            ValueError: the state holds more than fits.
        """
        states = state["states"]
        self._states, self._count, self._next = None, 0, state["next"]
        self._generator.bit_generator.state = state["generator"]
        if states is None:
            return
        if len(states) > self.capacity:
            raise ValueError(
                f"the saved start-state buffer holds {len(states)} states, more than the capacity of {self.capacity}"
            )
        self._states = np.zeros((self.capacity, states.shape[1]))
        self._states[: len(states)] = states
        self._count = len(states)


class CaseStartStateBuffer(StartStateBuffer):
    """A start-state buffer whose states end with the number of their case (an anatomy and a target, say).

    In one buffer for all, the cases that are solved every time crowd out those that are solved now and then: here
    every case is drawn equally often. Episodes that start as the task says take place the more often in a case, the
    more of its latest ones failed.

    Args:
        share: probability that `draw` gives a state, once there is one; from 0 to 1.
        capacity: number of states kept of each case.

    Raises:
        ValueError: a share outside 0 to 1, or a capacity below 1.
    """

    def __init__(self, cases: int, share: float = 0.5, capacity: int = 64, seed: int = 0) -> None:
        super().__init__(share, capacity, seed)
        self._failing = np.ones(cases)
        self._cases: dict[int, StartStateBuffer] = {}

    def __len__(self) -> int:
        return sum(len(buffer) for buffer in self._cases.values())

    def add_episode(self, states: NDArray[Any]) -> None:
        """Adds the states of an episode that reached the target.

        Args:
            states: shape (T, n); every row one that `env.reset(options={"start": row})` takes, its case last.

        Raises:
            ValueError: states of several cases, or as of `StartStateBuffer.add_episode`.
        """
        states = np.asarray(states, np.float64)
        cases = np.unique(states[:, -1]) if states.ndim == 2 else np.zeros(1)
        if len(cases) != 1:
            raise ValueError(f"an episode stays in one case, got states of {len(cases)}")
        case = int(cases[0])
        buffer = self._cases.get(case) or StartStateBuffer(1.0, self.capacity, int(self._generator.integers(1 << 31)))
        buffer.add_episode(states)
        self._cases[case] = buffer

    def draw(self) -> NDArray[np.float64] | None:
        """A state of a case drawn evenly, or None: start as the task says. Shape (n,)."""
        if not self._cases or self._generator.random() >= self.share:
            return None
        case = sorted(self._cases)[int(self._generator.integers(len(self._cases)))]
        return self._cases[case].draw()

    def choose_case(self) -> int:
        """The case of an episode that starts as the task says."""
        weight = np.cumsum(LEAST_WEIGHT + self._failing)
        return int(np.searchsorted(weight, self._generator.random() * weight[-1], side="right"))

    def record_outcome(self, case: int, *, success: bool) -> None:
        """Records how an episode ended that started as the task says."""
        self._failing[case] = EARLIER_WEIGHT * self._failing[case] + (1 - EARLIER_WEIGHT) * (not success)

    def state(self) -> dict[str, Any]:
        """Contents and random state, as plain data; for `restore`."""
        return {
            "cases": {case: buffer.state() for case, buffer in self._cases.items()},
            "failing": self._failing.copy(),
            "generator": self._generator.bit_generator.state,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Returns to a saved start-state buffer of the same capacity.

        Raises:
            ValueError: the state holds more of a case than fits.
        """
        self._cases, self._failing = {}, state["failing"].copy()
        for case, buffer in state["cases"].items():
            self._cases[case] = StartStateBuffer(1.0, self.capacity)
            self._cases[case].restore(buffer)
        self._generator.bit_generator.state = state["generator"]


def fill_start_state_buffer(start_state_buffer: StartStateBuffer, trajectories: Sequence[Trajectory]) -> int:
    """Adds the states of demonstrations that reached the target; returns how many episodes had them."""
    used = 0
    for trajectory in trajectories:
        if trajectory.terminated and trajectory.simulation_states is not None:
            start_state_buffer.add_episode(trajectory.simulation_states[:-1:RECORD_EVERY])
            used += 1
    return used
