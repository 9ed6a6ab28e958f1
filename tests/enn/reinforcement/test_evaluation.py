"""Evaluation: seeds, the best and the latest policy, free memory."""

import ctypes
import dataclasses
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch

from enn.policy import Policy
from enn.reinforcement.evaluation import BestPolicy, EpisodeOutcome, EvaluationResult, LatestPolicy, run_episodes
from enn.reinforcement.resources import Workers, available_bytes
from enn.reinforcement.training.training import Training
from tests.enn.conftest import PointEnv
from tests.enn.reinforcement.small_training import SMALL


def test_evaluation_is_the_same_for_the_same_seeds(point_env: Any) -> None:
    result = Training(dataclasses.replace(SMALL, decisions=800, evaluate_every=800), point_env, None, seed=1).run()
    for count in (1, 3):  # environments side by side
        again = run_episodes(
            result.policy, [point_env() for _ in range(count)], range(501_000, 501_005), deterministic=True,
            workers=Workers(count),
        )  # fmt: skip
        assert (again.success, again.steps) == (result.evaluation["success"], result.evaluation["steps"])
        assert again.path_mm == pytest.approx(result.evaluation["path_mm"])
    drawn = run_episodes(result.policy, [point_env()], range(9), deterministic=False)
    assert drawn == run_episodes(result.policy, [point_env()], range(9), deterministic=False)
    assert drawn != run_episodes(result.policy, [point_env()], range(9), deterministic=True)


def test_the_best_policy_is_kept_not_the_last(point_env: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    successes, weights = iter([1, 2, 2, 1]), []

    def played(policy: Policy, envs: Any, seeds: Any, *, deterministic: bool, **_: Any) -> EvaluationResult:
        if not deterministic:
            return EvaluationResult((EpisodeOutcome(True, 10, 0.0, 0.0, 0.0, 0.0),))
        assert len(seeds) == 3
        weights.append(torch.cat([value.flatten().clone() for value in policy.module.actor.parameters()]))
        success = next(successes)
        path_mm = 30.0 if len(weights) == 2 else 25.0
        return EvaluationResult(
            tuple(EpisodeOutcome(number < success, 20, 0.0, path_mm, 0.0, 0.0) for number in range(3))
        )

    monkeypatch.setattr("enn.reinforcement.evaluation.run_episodes", played)
    settings = dataclasses.replace(SMALL, decisions=240, learning_starts=40, evaluate_every=60, evaluation_episodes=3)
    result = Training(settings, point_env, None, seed=1).run()
    kept = torch.cat([value.flatten() for value in result.policy.module.actor.parameters()])
    # as successful as the second, but shorter
    assert [torch.equal(kept, one) for one in weights] == [False, False, True, False]
    assert result.evaluation["decisions"] == 184
    assert result.evaluation["path_mm"] == 25


@pytest.fixture(scope="module")
def untrained() -> Policy:
    return Training(dataclasses.replace(SMALL, decisions=16, evaluate_every=0), PointEnv, seed=0).run().policy


@pytest.mark.parametrize(("keeps_first", "kept"), [(True, 0), (False, 100)])
def test_a_policy_to_start_from_stays_until_another_one_arrives(
    keeps_first: bool, kept: int, untrained: Policy, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcomes = iter([(False, 0.0), (False, 1.0), (True, 0.0)])

    def played(policy: Policy, envs: Any, seeds: Any, *, deterministic: bool, **_: Any) -> EvaluationResult:
        success, reward = next(outcomes) if deterministic else (True, 0.0)
        return EvaluationResult((EpisodeOutcome(success, 10, reward, 5.0, 0.0, 0.0),))

    monkeypatch.setattr("enn.reinforcement.evaluation.run_episodes", played)
    best = BestPolicy(1, 0, keeps_first=keeps_first)
    for decisions in (0, 100):
        best.evaluate(untrained, [], decisions)
    assert best.best["evaluation"]["decisions"] == kept
    best.evaluate(untrained, [], 200)
    assert best.best["evaluation"]["decisions"] == 200


@pytest.mark.parametrize(
    ("arrived", "kept"),
    [
        ((12, 16, 15, 14), 2),  # one of 16 fewer than the best is chance, two are not
        ((16, 15, 14), 1),  # compared with the best, not with the kept one
        ((8, 6, 9), 2),
        ((0, 3, 0), 1),
    ],
)
def test_the_latest_policy_is_kept_unless_it_is_clearly_worse(
    arrived: tuple[int, ...], kept: int, untrained: Policy, monkeypatch: pytest.MonkeyPatch
) -> None:
    successes = iter(arrived)

    def played(policy: Policy, envs: Any, seeds: Any, *, deterministic: bool, **_: Any) -> EvaluationResult:
        assert not deterministic
        if seeds[0] == 500_000:  # scouts first, then the rest of the episodes
            played.success = next(successes)  # type: ignore[attr-defined]
        success = played.success  # type: ignore[attr-defined]
        return EvaluationResult(
            tuple(EpisodeOutcome(seed - 500_000 < success, 10, -1.0, 5.0, 0.0, 0.0) for seed in seeds)
        )

    monkeypatch.setattr("enn.reinforcement.evaluation.run_episodes", played)
    latest = LatestPolicy(16, 0)
    for number in range(len(arrived)):
        row = latest.evaluate(untrained, [], number)
        assert row["evaluation_success"] == row["evaluation_stochastic_success"] == arrived[number] / 16
    assert latest.best["evaluation"]["decisions"] == kept


# small blocks, so that all lie in the heap; one in a hundred stays, so that its end cannot sink
_PROGRAM = """
from pathlib import Path
from enn.reinforcement.resources import trim_heap

def resident_mb():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6

blocks = [bytearray(100_000) for _ in range(2000)]
blocks = blocks[::100]
before = resident_mb()
trim_heap()
print(before - resident_mb())
"""


@pytest.mark.skipif(
    os.name != "posix" or not hasattr(ctypes.CDLL(None), "malloc_trim") or not Path("/proc/self/statm").is_file(),
    reason="another C library than glibc",
)
def test_holes_in_the_heap_are_given_back() -> None:
    run = subprocess.run([sys.executable, "-c", _PROGRAM], capture_output=True, text=True, check=True)
    assert float(run.stdout) > 100
    assert available_bytes() > 0
