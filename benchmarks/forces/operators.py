"""Who steers: the sampling expert, random motions, a script without a target, a trained policy."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cathsim import NavigateEnv
from cathsim.planning.expert_settings import TWO_DEVICES
from cathsim.planning.sampling import SamplingExpert
from cathsim.planning.scripted_motions import MAX_ADVANCE, MAX_TURN, RandomMoves

if TYPE_CHECKING:
    from enn.policy import Policy

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


def trained(policy: Policy) -> Operator:
    """The operator "enn": a trained policy, deterministic."""

    def operator(environment: NavigateEnv, generator: np.random.Generator) -> Act:
        controller = policy.controller(seed=int(generator.integers(2**31)))
        return lambda observation: np.asarray(controller(observation), np.float64)

    return operator


def fits(policy: Policy, environment: NavigateEnv) -> bool:
    """Whether a policy was trained with actions and observations of these shapes."""
    spaces: Any = policy.observation_space, environment.observation_space
    shapes = [{key: one[key].shape for key in policy.keys} if policy.keys else one.shape for one in spaces]
    return policy.action_space.shape == environment.action_space.shape and shapes[0] == shapes[1]
