"""Memory that a training needs, beside the processor and on a GPU, before anything has run."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.stages.gpu_memory import policy_gb
from pipeline.stages.learning.task import LearningTask
from pipeline.task import DESCENDING

if TYPE_CHECKING:
    import gymnasium

    from enn.reinforcement.training import TrainingSettings

_GB = 1e9
PROCESS_GB = 1.0  # torch, simulator and networks; an estimate
_CHANNELS = {"image": 1, "mask": 1, "sequential": 3}  # of the observations that are images
_ROLLOUT_BYTES = 4  # a number of an observation in PPO's roll-out, which holds floats


def training_gb(task: LearningTask, keys: tuple[str, ...], settings: TrainingSettings, *, encoded: bool) -> float:
    """Memory of one training, nearly all of it the replay buffer or the roll-out.

    Args:
        encoded: whether an encoder turns them into features, which take next to nothing.
    """
    if encoded:
        return PROCESS_GB
    from enn.reinforcement.replay import nbytes_needed
    from enn.reinforcement.training.settings import PpoSettings, SacSettings

    arguments = {**task.task.arguments(), "entry": DESCENDING}  # another anatomy may not have that of the task
    observations, actions = _spaces(tuple(sorted(arguments.items())), keys)
    if isinstance(settings, SacSettings):
        needed = nbytes_needed(observations, settings.buffer_size, actions, half=settings.half)
    else:
        assert isinstance(settings, PpoSettings)
        numbers = sum(int(np.prod(space.shape or ())) for space in observations.spaces.values())
        needed = _ROLLOUT_BYTES * settings.n_steps * settings.n_envs * numbers
    return PROCESS_GB + needed / _GB


def training_gpu_gb(image_px: int, keys: tuple[str, ...], batch: int = 0) -> float:
    """GPU memory of one training.

    Args:
        batch: samples an update; 0: it learns from an encoder's features.
    """
    return policy_gb(image_px, sum(_CHANNELS.get(key, 0) for key in keys), batch)


@functools.cache
def _spaces(
    arguments: tuple[tuple[str, Any], ...], keys: tuple[str, ...]
) -> tuple[gymnasium.spaces.Dict, gymnasium.spaces.Box]:
    """What an environment gives and takes; that depends on neither anatomy nor target."""
    import gymnasium

    environment = gymnasium.make(
        "cathsim:cathsim/Navigate-v0", observation=keys, disable_env_checker=True, **dict(arguments)
    )
    observations, acts = environment.observation_space, environment.action_space
    environment.close()
    assert isinstance(observations, gymnasium.spaces.Dict)
    assert isinstance(acts, gymnasium.spaces.Box)
    return observations, acts
