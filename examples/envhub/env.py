"""cathsim for LeRobot's EnvHub: `make_env` as `lerobot.envs.factory.make_env("user/repository", …)` calls it.

The file is whole by itself: as `env.py` in a repository of the Hugging Face Hub it needs `endonav-cathsim` installed.
Observations have the names of exported data sets, so that a policy trained on one runs here:

| here | LeRobot's name | what |
|---|---|---|
| `pixels["frontal"]` (size, size, 3) uint8 | `observation.images.frontal` | fluoroscopic image |
| `agent_pos` (6,) or (10,) | `observation.state` | tip (m, world), insertion (m), cosine and sine of the rotation |
| `environment_state` (3,) | `observation.environment_state` | the target, m, world |
"""

from __future__ import annotations

from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv

from cathsim import NavigateEnv

SUITE = "cathsim"
TASKS = ("type_1/bca", "type_1/lcca")


class PixelsEnv(gymnasium.Env[dict[str, Any], np.ndarray]):
    """`NavigateEnv` with the observations that LeRobot expects, and `info["is_success"]`.

    Args:
        phantom, target: as of `NavigateEnv`.
        arguments: as of `NavigateEnv`; the images have `image_size` px, 80 unless given.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": NavigateEnv.metadata["render_fps"]}  # noqa: RUF012
    render_mode = "rgb_array"

    def __init__(self, phantom: str, target: Any, **arguments: Any) -> None:
        observation = ("image", "tip", "feeder", "goal")
        self.env = NavigateEnv(phantom, target, observation=observation, render_mode="fluoroscopy", **arguments)
        spaces = self.env.observation_space
        assert isinstance(spaces, gymnasium.spaces.Dict)
        size, state = spaces["image"].shape[1:], 3 + spaces["feeder"].shape[0]
        box = gymnasium.spaces.Box
        self.observation_space = gymnasium.spaces.Dict(
            {
                "pixels": gymnasium.spaces.Dict({"frontal": box(0, 255, (*size, 3), np.uint8)}),
                "agent_pos": box(-np.inf, np.inf, (state,), np.float32),
                "environment_state": box(-np.inf, np.inf, (3,), np.float32),
            }
        )
        self.action_space = self.env.action_space
        self._max_episode_steps = self.env.task.max_steps
        self.task = self.task_description = f"reach the {self.env.task.target_name} in {self.env.phantom.name}"

    def _seen(self, observation: dict[str, np.ndarray]) -> dict[str, Any]:
        return {
            "pixels": {"frontal": np.repeat(observation["image"][0][..., None], 3, axis=2)},
            "agent_pos": np.concatenate((observation["tip"], observation["feeder"])),
            "environment_state": observation["goal"],
        }

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode, as `NavigateEnv.reset` does."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._seen(observation), info | {"is_success": info["success"]}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Advance by one control step, as `NavigateEnv.step` does."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._seen(observation), reward, terminated, truncated, info | {"is_success": info["success"]}

    def render(self) -> Any:
        """Give the fluoroscopic image, (height, width, 3) uint8."""
        return self.env.render()

    def close(self) -> None:
        """Free the renderer."""
        self.env.close()


def make_env(
    n_envs: int = 1, use_async_envs: bool = False, cfg: Any = None, **arguments: Any
) -> dict[str, dict[int, VectorEnv]]:
    """Make vectors of environments; each restarts in the step in which its episode ends.

    Args:
        n_envs: environments of each task.
        use_async_envs: in processes of their own.
        cfg: LeRobot's configuration; of it `task` is read, "PHANTOM/TARGET". None: all of `TASKS`.
        arguments: of `NavigateEnv`.

    Returns:
        By suite and number of the task.

    Raises:
        ValueError: fewer than one environment, or a task that is no phantom and target.
    """
    if n_envs < 1:
        raise ValueError(f"n_envs must be at least 1, got {n_envs}")
    task_name = getattr(cfg, "task", None)
    kind = AsyncVectorEnv if use_async_envs else SyncVectorEnv
    made: dict[int, VectorEnv] = {}
    for number, task in enumerate(TASKS if task_name is None else (task_name,)):
        phantom, slash, target = str(task).partition("/")
        if not (phantom and slash and target):
            raise ValueError(f"a task is PHANTOM/TARGET, such as {TASKS[0]}, got {task!r}")
        one = partial(PixelsEnv, phantom, target, **arguments)
        made[number] = kind([one] * n_envs, autoreset_mode=AutoresetMode.SAME_STEP)
    return {SUITE: made}
