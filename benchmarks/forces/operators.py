"""Who steers: the sampling expert, random motions, a script without a target, a trained policy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cathsim import NavigateEnv
from cathsim.planning.expert_settings import TWO_DEVICES
from cathsim.planning.sampling import SamplingExpert
from cathsim.planning.scripted_motions import MAX_ADVANCE, MAX_TURN, RandomMoves

if TYPE_CHECKING:
    from benchmarks.forces.episodes import Case
    from enn.policy import Policy

WIRE = "wire"  # the device without a catheter

Array = NDArray[np.float64]
Act = Callable[[Any], Array]  # from an observation to the next motion, in shares of a full step
Operator = Callable[[NavigateEnv, np.random.Generator], Act]


def expert(environment: NavigateEnv, generator: np.random.Generator) -> Act:
    """The sampling expert, with the same settings for the wire alone and for two devices."""
    sampling = SamplingExpert(environment, seed=int(generator.integers(2**31)), settings=TWO_DEVICES, threads=1)
    return lambda _: sampling.action()


def uniform(environment: NavigateEnv, generator: np.random.Generator) -> Act:
    """Uniformly random motions."""
    return lambda _: generator.uniform(-1.0, 1.0, environment.feeders.shape)


def push_and_turn(environment: NavigateEnv, generator: np.random.Generator) -> Act:
    """The scripted motion "advance" of each device, without a look at the target."""
    moves = [RandomMoves("advance", generator) for _ in range(environment.feeders.shape[0] // 2)]
    return lambda _: np.concatenate([one.next() for one in moves]) / np.tile((MAX_ADVANCE, MAX_TURN), len(moves))


OPERATORS: dict[str, Operator] = {"expert": expert, "random": uniform, "push_and_turn": push_and_turn}


@dataclass(frozen=True)
class TrainedOperator:
    """A trained policy as an operator: the "enn" of its stage, deterministic, or a "policy" by a roadmap, drawn.

    Args:
        source: a policy's file, or the name of a shipped one.
    """

    source: str

    @cached_property
    def policy(self) -> Policy:
        """The policy itself."""
        from enn.policy import Policy
        from enn.shipped import load, models

        return load(self.source) if self.source in models() else Policy.load(Path(self.source))  # type: ignore[return-value]

    @property
    def name(self) -> str:
        """What it is called in the tables."""
        return "enn" if self.policy.metadata.get("stage") == "enn" else "policy"

    def fits(self, case: Case) -> bool:
        """Whether it was trained with such actions and observations, and, where it says so, the devices and target."""
        known = self.policy.metadata
        device = (known["task"]["catheter"] or WIRE) if "task" in known else case.device
        if device != case.device or known.get("target", case.target) != case.target:
            return False
        environment = case.environment(self.observation)
        spaces: Any = self.policy.observation_space, environment.observation_space
        keys = self.policy.keys
        shapes = [{key: one[key].shape for key in keys} if keys else one.shape for one in spaces]
        action_shape = environment.action_space.shape
        environment.close()
        return self.policy.action_space.shape == action_shape and shapes[0] == shapes[1]

    @property
    def observation(self) -> str | Sequence[str]:
        """What it sees, as an environment's argument."""
        return self.policy.keys or "internal"

    def __call__(self, environment: NavigateEnv, generator: np.random.Generator) -> Act:
        """A controller of an episode."""
        controller = self.policy.controller(self.name == "enn", seed=int(generator.integers(2**31)))
        return lambda observation: np.asarray(controller(observation), np.float64)
