"""A training that starts from a policy: what it takes over, what it refuses, and that it goes on exactly."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from enn.policy import Policy
from enn.reinforcement.checkpoint import CheckpointError
from enn.reinforcement.training import Progress, Training
from tests.enn.conftest import PointEnv
from tests.enn.reinforcement.small_training import SMALL

SHORT = dataclasses.replace(SMALL, stop_after=0, decisions=400, evaluate_every=200, keep_critics=True)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("trained")
    settings = dataclasses.replace(SMALL, gradient_steps=1.0, keep_critics=True)
    Training(settings, PointEnv, folder, seed=3).run()
    return folder / "policy.pt"


def test_the_critics_are_kept_and_read(trained: Path, tmp_path: Path) -> None:
    policy = Policy.load(trained)
    assert policy.critics
    policy.save(tmp_path / "acting.pt")
    acting = Policy.load(tmp_path / "acting.pt")
    assert not acting.critics
    observation = {"place": np.array([0.3, -0.2], np.float32)}
    np.testing.assert_array_equal(acting.act(observation), policy.act(observation))
    assert (tmp_path / "acting.pt").stat().st_size < 0.5 * trained.stat().st_size
    with pytest.raises(ValueError, match="this policy has no critics"):
        acting.save(tmp_path / "again.pt", critics=True)


def test_it_begins_with_the_policys_weights_and_keeps_them_if_none_are_better(trained: Path, point_env: Any) -> None:
    initial = Policy.load(trained)
    settings = dataclasses.replace(SHORT, decisions=200, learning_starts=200, evaluate_every=200)
    result = Training(settings, point_env, seed=5, initial=initial).run()
    for name, value in initial.module.state_dict().items():
        torch.testing.assert_close(result.policy.module.state_dict()[name], value, rtol=0, atol=0, msg=name)
    assert result.timings["updates"] == 0
    # it acts itself from the first decision on: nearly every training episode succeeds
    assert result.curve[-1]["success"] > 0.8


def test_an_interrupted_one_goes_on_exactly(
    trained: Path, point_env: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("enn.reinforcement.training.training.TICK", 0.0)
    initial = Policy.load(trained)
    whole = Training(SHORT, point_env, tmp_path / "whole", seed=5, initial=initial).run()

    def stop(progress: Progress) -> None:
        if progress.decisions >= 250:
            raise KeyboardInterrupt

    settings = dataclasses.replace(SHORT, checkpoint_seconds=0.0)
    with pytest.raises(KeyboardInterrupt):
        Training(settings, point_env, tmp_path / "parts", seed=5, initial=initial).run(stop)
    other = Policy.load(trained)
    next(other.module.parameters()).data.add_(1e-3)
    with pytest.raises(CheckpointError, match="its initial is"):
        Training(settings, point_env, tmp_path / "parts", seed=5, initial=other).run()
    parts = Training(settings, point_env, tmp_path / "parts", seed=5, initial=initial).run()
    for name, value in whole.policy.module.state_dict().items():
        torch.testing.assert_close(parts.policy.module.state_dict()[name], value, rtol=0, atol=0, msg=name)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"hidden": (16, 16)}, r"hidden=\(32, 32\), not \(16, 16\)"),
        ({"action_repeat": 2}, "holds actions for 1 steps, the training for 2"),
    ],
)
def test_another_network_is_refused(trained: Path, point_env: Any, changed: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Training(dataclasses.replace(SHORT, **changed), point_env, initial=Policy.load(trained)).run()


def test_a_policy_without_critics_is_refused(trained: Path, point_env: Any, tmp_path: Path) -> None:
    Policy.load(trained).save(tmp_path / "acting.pt")
    with pytest.raises(ValueError, match="has no critics"):
        Training(SHORT, point_env, initial=Policy.load(tmp_path / "acting.pt")).run()
