"""Memory that a job is expected to need, beside the processor and on a GPU: an estimate, before anything has run.

While a job runs its process tells what it really uses of a GPU; `pipeline.jobs.machine` goes by that where it is more.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.jobs.machine import CUDA_CONTEXT_BYTES
from pipeline.stages.learning.task import LearningTask
from pipeline.task import DESCENDING

if TYPE_CHECKING:
    import gymnasium

    from enn.reinforcement.training.settings import TrainingSettings


_GB = 1e9
CONTEXT_GB = CUDA_CONTEXT_BYTES / _GB
# Bytes kept for the way back of a pixel of an image through the thesis's convolutions (32 channels at a quarter of the
# side, 64 at an eighth, twice, with what follows each), and how many such networks an update of SAC passes, twice.
_BYTES_A_PIXEL = 16
_PASSES = 8
_LEAST_BATCH = 512  # images that pass a network together where nothing is learnt
LEARNT_BATCH = 64  # samples an update of what learns from episodes
_WEIGHTS_GB = 0.4  # weights, gradients, moments and copies of the networks that steer; a GRU's workspace
# Bytes kept for the way back of a pixel of what the network sees, counted on the CPU for one image (a clip of three for
# the shape networks), and the number of weights: of the thesis's sizes, and of a desk's, which serve for a smoke's too.
# See docs/results/computing.md.
_THESIS = {
    "unet": (3280, 31.0e6), "transunet": (8070, 105.3e6), "swinunet": (4160, 27.2e6), "fgrn": (400, 3.4e6),
    "shape": (9250, 88.1e6), "published": (164, 15.8e6), "ordered": (268, 22.7e6),
}  # fmt: skip
_DESK = {
    "unet": (620, 0.1e6), "transunet": (680, 0.7e6), "swinunet": (2030, 1.7e6), "fgrn": (400, 3.4e6),
    "shape": (286, 2.2e6), "published": (61, 5.3e6), "ordered": (74, 2.1e6),
}  # fmt: skip
_BYTES_A_WEIGHT = 20  # itself, its gradient, two moments, the best so far
_SEGMENTATION, _SPLINEFORMER = ("unet", "transunet", "swinunet"), ("published", "ordered")  # keys of both tables


def policy_gb(image_px: int, channels: int, batch: int = 0) -> float:
    """For a policy, a student or a force predictor that sees so many grey images at once; 0: vectors alone."""
    pixels = max(batch * _PASSES, _LEAST_BATCH) * max(channels, 0) * image_px**2
    return CONTEXT_GB + _WEIGHTS_GB + pixels * _BYTES_A_PIXEL / _GB


def network_gb(network: str, size: str) -> float:
    """For a network on images of a data set."""
    side, batch = _seen(network, size)
    table = _DESK if size in ("desk", "smoke") else _THESIS
    bytes_a_pixel, weights = table.get(network, table["shape"])
    # the half of it that mixed precision saves is what the allocator cannot use, and workspaces of convolutions
    return CONTEXT_GB + (_BYTES_A_WEIGHT * weights + batch * side**2 * bytes_a_pixel) / _GB


def _seen(network: str, size: str) -> tuple[int, int]:
    """Side of what a network sees, px, and how many of them an update."""
    if network in _SPLINEFORMER:
        from splineformer.build import size_of
        from splineformer.learning.recipes import recipe_of

        return size_of(network, size).image_px, recipe_of(network, size).fit.batch_size
    from guide3d.learning.recipes import fgrn_recipe, segmentation_recipe, shape_recipe

    if network in _SEGMENTATION:
        recipe = segmentation_recipe(network, size)
        return recipe.crop_px, recipe.fit.batch_size
    image_recipe = fgrn_recipe(size) if network == "fgrn" else shape_recipe(size)
    return image_recipe.preprocessing.size_px, image_recipe.fit.batch_size


PROCESS_GB = 1.0  # torch, simulator and networks; an estimate
_CHANNELS = {"image": 1, "mask": 1, "sequential": 3}  # of the observations that are images
_ROLLOUT_BYTES = 4  # a number of an observation in PPO's roll-out, which holds floats


def training_gb(task: LearningTask, keys: tuple[str, ...], settings: TrainingSettings, *, encoded: bool) -> float:
    """Memory of one training, nearly all of it replay buffer or roll-out; features of an encoder take little."""
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
    """GPU memory of one training with so many samples an update; 0: it learns from an encoder's features."""
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
