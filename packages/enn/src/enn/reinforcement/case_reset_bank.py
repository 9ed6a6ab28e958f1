"""Reset bank over many cases: each has room of its own, and new episodes go where they fail."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from enn.reinforcement.reset_bank import ResetBank

LEAST_WEIGHT = 0.15  # of a case that is always solved; one that never is has 1 more
MEMORY = 0.5  # weight of a case's earlier episodes beside its latest


class CaseBank(ResetBank):
    """A reset bank whose states end with the number of their case (an anatomy and a target, say).

    In one bank for all, the cases that are solved every time crowd out those that are solved now and then: here every
    case is drawn equally often. Episodes that start as the task says take place the more often in a case, the more of
    its latest ones failed.

    Args:
        cases: how many there are.
        share: probability that `draw` gives a state, once there is one; from 0 to 1.
        capacity: number of states kept of each case.
        seed: of the draws.

    Raises:
        ValueError: a share outside 0 to 1, or a capacity below 1.
    """

    def __init__(self, cases: int, share: float = 0.5, capacity: int = 64, seed: int = 0) -> None:
        super().__init__(share, capacity, seed)
        self._failing = np.ones(cases)
        self._cases: dict[int, ResetBank] = {}

    def __len__(self) -> int:
        """Number of states there are."""
        return sum(len(bank) for bank in self._cases.values())

    def add_episode(self, states: NDArray[Any]) -> None:
        """Adds the states of an episode that reached the target.

        Args:
            states: shape (T, n); every row one that `env.reset(options={"start": row})` takes, its case last.

        Raises:
            ValueError: states of several cases, or as of `ResetBank.add_episode`.
        """
        states = np.asarray(states, np.float64)
        cases = np.unique(states[:, -1]) if states.ndim == 2 else np.zeros(1)
        if len(cases) != 1:
            raise ValueError(f"an episode stays in one case, got states of {len(cases)}")
        case = int(cases[0])
        bank = self._cases.get(case) or ResetBank(1.0, self.capacity)
        bank.add_episode(states)
        self._cases[case] = bank

    def draw(self) -> NDArray[np.float64] | None:
        """A state of a case drawn evenly, or None: start as the task says. Shape (n,)."""
        if not self._cases or self._generator.random() >= self.share:
            return None
        case = sorted(self._cases)[int(self._generator.integers(len(self._cases)))]
        return self._cases[case].draw()

    def choose(self) -> int:
        """The case of an episode that starts as the task says."""
        weight = np.cumsum(LEAST_WEIGHT + self._failing)
        return int(np.searchsorted(weight, self._generator.random() * weight[-1], side="right"))

    def judge(self, case: int, *, success: bool) -> None:
        """Takes note of how an episode ended that started as the task says."""
        self._failing[case] = MEMORY * self._failing[case] + (1 - MEMORY) * (not success)

    def state(self) -> dict[str, Any]:
        """Contents and random state, as plain data; for `restore`."""
        return {
            "cases": {case: bank.state() for case, bank in self._cases.items()},
            "failing": self._failing.copy(),
            "generator": self._generator.bit_generator.state,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Returns to a state of a bank with the same capacity.

        Raises:
            ValueError: the state holds more of a case than fits.
        """
        self._cases, self._failing = {}, state["failing"].copy()
        for case, kept in state["cases"].items():
            self._cases[case] = ResetBank(1.0, self.capacity)
            self._cases[case].restore(kept)
        self._generator.bit_generator.state = state["generator"]
