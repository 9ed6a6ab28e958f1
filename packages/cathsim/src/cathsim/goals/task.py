"""The task of a goal-conditioned episode: a reward that depends on the place reached and the place wanted alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cathsim.navigation import NavigationTask, Reward, reward_name
from cathsim.validation import settings

REWARDS = ("sparse", "dense")
MISSED = -1.0  # reward of a step that ends away from the goal
Infos = Mapping[str, Any] | Sequence[Mapping[str, Any]]


@settings
class GoalTask(NavigationTask):
    """The tip within `success_radius` of a goal.

    Attributes:
        reward: "sparse": 0 within `success_radius` of the goal, else -1; "dense": minus the Euclidean distance to it in
            metres; or a function of achieved and desired goals (..., 3), m, and info, which returns shape (...).
        force_penalty: subtracted per newton by which `info["force"]` exceeds `force_threshold`.
        success: must be "straight", as a reward of two places knows no lumen.
        path_penalty: must be 0, as a goal does not say how far the tip has moved.
    """

    success: Literal["lumen", "straight"] = "straight"
    reward: Reward = "sparse"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.success != "straight":
            raise ValueError(f"success must be 'straight' in a goal-conditioned task, got {self.success!r}")
        if self.path_penalty:
            raise ValueError("path_penalty must be 0 in a goal-conditioned task: its reward knows places, no path")

    @classmethod
    def reward_names(cls) -> tuple[str, ...]:
        """The rewards that have a name."""
        return REWARDS

    @property
    def reads_progress(self) -> bool:
        """No reward of this task depends on the progress along the lumen."""
        return False

    def step_reward(
        self, distance: float, progress: float, force: float, moved: float = 0.0, *, success: bool
    ) -> float:
        """Reward of a step towards the task's own target, as `goal_reward` gives it; of distance and force alone."""
        reached = 0.0 if distance <= self.success_radius else MISSED
        return self.penalised(-distance if self.reward == "dense" else reached, force, moved)

    def reward_of(
        self, info: Mapping[str, Any], progress: float, moved: float, action: np.ndarray, *, success: bool
    ) -> float:
        """As of `NavigationTask`; a function of goals is refused with a ValueError: only `NavigateGoalEnv` has them."""
        if not isinstance(self.reward, str):
            raise ValueError(f"{reward_name(self.reward)} is a function of goals: take NavigateGoalEnv")
        return super().reward_of(info, progress, moved, action, success=success)

    def goal_reward(
        self, achieved: NDArray[np.floating], desired: NDArray[np.floating], info: Infos
    ) -> NDArray[np.float64]:
        """Rewards of places for goals.

        Args:
            achieved: the tip, m. Shape (..., 3).
            desired: the goal, m. Shape (..., 3).
            info: of the step, or a sequence with that of each; read where there is a `force_penalty`.

        Returns:
            Shape (...).

        Raises:
            ValueError: the shapes do not fit, a function's rewards are not finite numbers of that shape, or `info`
                lacks the forces.
        """
        achieved, desired = np.asarray(achieved, np.float64), np.asarray(desired, np.float64)
        if achieved.shape != desired.shape or achieved.shape[-1:] != (3,):
            raise ValueError(f"expected two arrays of one shape (..., 3), got {achieved.shape} and {desired.shape}")
        if not isinstance(self.reward, str):
            raw_reward = self.reward(achieved, desired, info)
            reward = np.asarray(raw_reward)
            shape = achieved.shape[:-1]
            if reward.shape != shape or reward.dtype.kind not in "biuf" or not np.isfinite(reward).all():
                raise ValueError(
                    f"{reward_name(self.reward)} must give finite numbers of shape {shape}, gave {raw_reward!r}"
                )
            reward = reward.astype(np.float64)
        else:
            x, y, z = np.moveaxis(achieved - desired, -1, 0)
            distance = np.sqrt(x * x + y * y + z * z)  # the same bits for one goal as for many
            reward = -distance if self.reward == "dense" else np.where(distance <= self.success_radius, 0.0, MISSED)
        if not self.force_penalty:
            return reward
        pressed = np.maximum(_forces(info, achieved.shape[:-1]) - self.force_threshold, 0.0)
        return reward - self.force_penalty * pressed


def _forces(info: Infos, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """The forces of the steps, N."""
    try:
        values = info["force"] if isinstance(info, Mapping) else [one["force"] for one in info]
        return np.asarray(values, np.float64).reshape(shape)
    except (KeyError, TypeError, ValueError):
        raise ValueError(
            "a reward with force_penalty needs info['force'] of every step: keep the infos beside the transitions "
            "(copy_info_dict=True of Stable-Baselines3's HerReplayBuffer)"
        ) from None
