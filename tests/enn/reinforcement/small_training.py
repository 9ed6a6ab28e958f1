"""A training of the toy environment that takes about a second, and demonstrations of it."""

import dataclasses
from typing import Any

import numpy as np
import pytest
import torch

from enn.imitation.dagger import record
from enn.policy import Policy
from enn.reinforcement.training.result import Progress
from enn.reinforcement.training.settings import DESK_SAC
from enn.reinforcement.training.training import Training
from enn.trajectory import Trajectory

SMALL = dataclasses.replace(
    DESK_SAC,
    action_repeat=1,
    decisions=900,
    hidden=(32, 32),
    critic_layer_norm=False,
    final_learning_rate=1.0,
    batch_size=32,
    learning_starts=200,
    gradient_steps=0.5,
    evaluate_every=300,
    stop_after=2,
    evaluation_episodes=5,
    curve_every=100,
    buffer_size=2000,
)


def demonstrated(point_env: Any) -> list[Trajectory]:
    """Three episodes straight to the target."""
    env = point_env()

    def straight(observation: Any, info: Any) -> np.ndarray:
        return np.clip(-observation["place"] / 0.15, -1, 1)

    return [record(env, straight, seed=seed, keys=("place",), start_state=env.start_state) for seed in range(3)]


class Interruption(Exception):
    """Stops a training."""


def interrupted(training: Training, decisions: int = 0) -> None:
    """Runs a training that has a folder until it has made some decisions."""

    def stop(moment: Progress) -> None:
        if moment.decisions >= decisions:
            raise Interruption

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("enn.reinforcement.training.training.TICK", 0.0)
        with pytest.raises(Interruption):
            training.run(stop)


def require_same_weights(first: Policy, second: Policy) -> None:
    """Of every part of both networks, bit for bit."""
    theirs = second.module.state_dict()
    for name, value in first.module.state_dict().items():
        assert torch.equal(value, theirs[name]), name
