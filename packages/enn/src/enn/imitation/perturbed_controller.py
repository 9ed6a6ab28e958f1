"""Perturbed controller: a policy whose actions are mixed with correlated noise, to see states that it would avoid."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from enn.policy import Policy

CORRELATION = 0.8  # of the noise of one action and the next


class PerturbedController:
    """A policy over one episode, disturbed by a share of noise that is drawn once, from none to nothing else.

    Args:
        policy: that steers; each action is held for its action repeat.
    """

    def __init__(self, policy: Policy, generator: np.random.Generator) -> None:
        self._policy, self._generator = policy, generator
        self._size = int(np.prod(policy.action_space.shape or ()))
        self._share = generator.uniform()
        self._noise = generator.normal(0.0, 1.0, self._size)
        self._left = 0
        self._action: NDArray[np.float32] = np.zeros(self._size, np.float32)

    def __call__(self, observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
        """The action of this step, in -1 to 1. Shape (actions,)."""
        if self._left == 0:
            fresh = self._generator.normal(0.0, 1.0, self._size)
            self._noise = CORRELATION * self._noise + np.sqrt(1 - CORRELATION**2) * fresh
            advice = self._policy.act_batch({key: observation[key][None] for key in self._policy.keys})[0]
            mixed = (1 - self._share) * advice + self._share * self._noise
            self._action = np.clip(mixed, -1.0, 1.0).astype(np.float32)
            self._left = self._policy.action_repeat
        self._left -= 1
        return self._action
