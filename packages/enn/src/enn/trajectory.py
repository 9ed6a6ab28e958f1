"""Trajectory: the arrays of one episode, with the invariants that everything learnt from episodes relies on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Trajectory:
    """One episode of T >= 1 steps; what is observed has one entry more, the last moment.

    Raises:
        ValueError: when lengths disagree, or a value is not finite; the message names the array and both sides.
    """

    observations: dict[str, NDArray[Any]]  # name to (T + 1, ...), the episode's start and the moment after every step
    actions: NDArray[Any]  # (T, a), within -1 and 1
    rewards: NDArray[Any]  # (T,)
    terminated: bool  # whether the target was reached (an episode that was cut off was not)
    forces: NDArray[Any]  # (T,) N, largest contact force of each step
    tips: NDArray[Any]  # (T + 1, 3) m, tip positions, world frame
    simulation_states: NDArray[Any] | None = None  # (T + 1, n) states that an episode can be started from, or None
    # whatever else belongs to it: phantom, target, seed, wire, file
    metadata: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.actions.ndim != 2 or len(self.actions) == 0:
            raise ValueError(f"actions must have shape (T, a) with T >= 1, got {self.actions.shape}")
        steps = len(self.actions)
        for name, array in (("rewards", self.rewards), ("forces", self.forces)):
            if array.shape != (steps,):
                raise ValueError(f"{name} of {steps} actions must have shape ({steps},), got {array.shape}")
        if self.tips.shape != (steps + 1, 3):
            raise ValueError(f"tips of {steps} actions must have shape ({steps + 1}, 3), got {self.tips.shape}")
        if self.simulation_states is not None and (
            self.simulation_states.ndim != 2 or len(self.simulation_states) != steps + 1
        ):
            raise ValueError(
                f"simulation_states of {steps} actions must have shape ({steps + 1}, n), "
                f"got {self.simulation_states.shape}"
            )
        for name, array in self.observations.items():
            if len(array) != steps + 1:
                raise ValueError(f"observation '{name}' of {steps} actions needs {steps + 1} entries, got {len(array)}")
        named = {name: getattr(self, name) for name in ("actions", "rewards", "forces", "tips", "simulation_states")}
        for name, array in (*self.observations.items(), *named.items()):
            if array is None:
                continue
            if array.dtype.kind == "f" and not np.isfinite(array).all():
                step = int(np.argwhere(~np.isfinite(array))[0][0])
                raise ValueError(f"'{name}' is not finite at step {step}: leave this episode out")
        if (self.forces < 0).any():
            raise ValueError(f"forces are magnitudes and cannot be negative, got {self.forces.min():.3g} N")

    def __len__(self) -> int:
        """Number of steps T."""
        return len(self.actions)

    def require(self, keys: Sequence[str]) -> None:
        """Refuses a trajectory that lacks an observation.

        Raises:
            ValueError: naming what is missing and what there is.
        """
        missing = [key for key in keys if key not in self.observations]
        if missing:
            names = ", ".join(self.observations) or "none"
            raise ValueError(f"{self.label} has no observation {', '.join(missing)}; it has {names}")

    @property
    def label(self) -> str:
        """Its file if the metadata knows one, to name it in messages."""
        return str(self.metadata.get("file", "the trajectory"))


def require_same_shapes(trajectories: Sequence[Trajectory], keys: Sequence[str]) -> dict[str, tuple[int, ...]]:
    """Checks that episodes can be learnt from together: same observations, same actions.

    Returns:
        Name to the shape of one observation.

    Raises:
        ValueError: when there are none, one lacks an observation, or shapes differ (another wire or image size); the
            message names the episode.
    """
    if not trajectories:
        raise ValueError("there are no episodes to learn from: record some first")
    first = trajectories[0]
    for trajectory in trajectories:
        trajectory.require(keys)
        for key in keys:
            expected, got = first.observations[key].shape[1:], trajectory.observations[key].shape[1:]
            if got != expected:
                cause = "image size" if len(expected) == 3 else "wire"
                raise ValueError(
                    f"{trajectory.label} was recorded with another {cause}: its '{key}' has shape {got}, the other "
                    f"episodes' {expected}; keep episodes of one kind together"
                )
        if trajectory.actions.shape[1] != first.actions.shape[1]:
            raise ValueError(
                f"{trajectory.label} has {trajectory.actions.shape[1]} actions, the other episodes "
                f"{first.actions.shape[1]}: keep episodes of one kind together"
            )
    return {key: first.observations[key].shape[1:] for key in keys}


def join(
    trajectories: Sequence[Trajectory], keys: Sequence[str]
) -> tuple[dict[str, NDArray[Any]], NDArray[np.float32], NDArray[np.float32]]:
    """Lays episodes end to end as samples of (observation before the step, action, force of the step).

    Args:
        trajectories: at least one, of one kind.

    Returns:
        Observations (name to (N, ...)), actions (N, a) and forces (N,) N, where N is the sum of all T.

    Raises:
        ValueError: as `require_same_shapes`.
    """
    require_same_shapes(trajectories, keys)
    observations = {key: np.concatenate([t.observations[key][:-1] for t in trajectories]) for key in keys}
    actions = np.concatenate([t.actions for t in trajectories]).astype(np.float32)
    forces = np.concatenate([t.forces for t in trajectories]).astype(np.float32)
    return observations, actions, forces


def episode_numbers(trajectories: Sequence[Trajectory]) -> NDArray[np.int64]:
    """The number of the episode that each sample of `join` is from. Shape (N,)."""
    return np.repeat(np.arange(len(trajectories)), [len(trajectory) for trajectory in trajectories])
