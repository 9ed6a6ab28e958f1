"""Demonstrations: how episodes of an expert enter the replay buffer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium
import numpy as np

from enn.reinforcement.replay import ReplayBuffer
from enn.trajectory import Trajectory


def demonstration_replay(
    trajectories: Sequence[Trajectory],
    space: gymnasium.Space[Any],
    action_space: gymnasium.spaces.Box,
    *,
    action_repeat: int = 1,
    encode: Callable[[dict[str, Any]], dict[str, Any]] | None = None,
    seed: int = 0,
) -> ReplayBuffer:
    """A replay buffer filled with demonstrations.

    With an action repeat, a decision is the mean of the actions that it stands for, and the sum of their rewards: an
    approximation, since the demonstrator did not hold them.

    Args:
        trajectories: with rewards of the task that is trained; at least one.
        action_repeat: environment steps a decision.
        encode: observations, name to (T + 1, ...), to those that reach the network.

    Raises:
        ValueError: there are no trajectories, or one lacks an observation.
    """
    if not trajectories:
        raise ValueError("there are no demonstrations to put into the replay buffer")
    names = list(space) if isinstance(space, gymnasium.spaces.Dict) else []
    decisions = sum(-(-len(trajectory) // action_repeat) for trajectory in trajectories)
    buffer = ReplayBuffer(decisions, space, action_space, seed=seed)
    half = 0.5 * (action_space.high - action_space.low)
    for trajectory in trajectories:
        if encode is not None:
            seen = encode(trajectory.observations)
        else:
            trajectory.require(names)
            seen = trajectory.observations
        for start in range(0, len(trajectory), action_repeat):
            end = min(start + action_repeat, len(trajectory))
            last = end == len(trajectory)
            before = {name: seen[name][start][None] for name in names}
            after = {name: seen[name][end][None] for name in names}
            if not names:
                single = next(iter(seen.values()))
                before, after = single[start][None], single[end][None]
            action = (trajectory.actions[start:end].mean(axis=0) - action_space.low) / half - 1.0
            cut = [{"TimeLimit.truncated": not trajectory.terminated}]
            reward = trajectory.rewards[start:end].sum()
            buffer.add(before, after, action[None], np.array([reward]), np.array([last]), cut)
    return buffer
