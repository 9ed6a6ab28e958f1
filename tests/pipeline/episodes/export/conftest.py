"""Recorded episodes for the tests of export: of a wire, and of a wire in a catheter."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cathsim import NavigateEnv
from pipeline.recording.record import record_episode

TARGETS = ("bca", "lcca")
SIZE = 48
STEPS = 7


def record(folder: Path, *, pictures: bool = True, **arguments: Any) -> Path:
    """Record an episode towards each target, the second one step longer; observations are kept beside each log."""
    for seed, target in enumerate(TARGETS):
        made = {"accuracy": "fast", "image_size": SIZE, "max_steps": STEPS + seed, **arguments}
        environment = NavigateEnv("type_1", target, observation=("tip", "feeder"), **made)
        size = (STEPS + seed, *environment.action_space.shape)
        drawn = iter(np.random.default_rng(seed).uniform(0, 1, size).astype(np.float32))
        seen: list[np.ndarray] = []

        def policy(observation: Any, info: Any, drawn: Any = drawn, seen: Any = seen) -> np.ndarray:
            seen.append(np.concatenate((observation["tip"], observation["feeder"])))
            return next(drawn)

        record_episode(environment, policy, folder / f"{seed}.mcap", seed=seed, operator="test", pictures=pictures)
        np.save(folder / f"{seed}.npy", np.array(seen))
    return folder


@pytest.fixture(scope="session")
def record_logs() -> Callable[..., Path]:
    return record


@pytest.fixture(scope="session")
def wire_logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("wire"))


@pytest.fixture(scope="session")
def dual_logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("dual"), catheter="vertebral")
