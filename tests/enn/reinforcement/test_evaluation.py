"""Evaluation: the same for the same seeds; which weights are kept, scouts, the early end."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest
import torch

from enn.policy import Policy
from enn.reinforcement.evaluation import (
    BestPolicy,
    EpisodeOutcome,
    EvaluationResult,
    LatestPolicy,
    run_episodes,
    standard_error,
)
from enn.reinforcement.training import Training
from enn.reinforcement.workers import Workers
from tests.enn.reinforcement.small_training import SMALL


def test_evaluation_is_the_same_for_the_same_seeds(point_env: Any) -> None:
    result = Training(dataclasses.replace(SMALL, decisions=800, evaluate_every=800), point_env, None, seed=1).run()
    assert result.evaluation is not None
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
    settings = dataclasses.replace(SMALL, decisions=800, evaluate_every=200, evaluation_episodes=3)
    result = Training(settings, point_env, None, seed=1).run()
    kept = torch.cat([value.flatten() for value in result.policy.module.actor.parameters()])
    # as successful as the second, but shorter
    assert [torch.equal(kept, one) for one in weights] == [False, False, True, False]
    assert result.evaluation is not None
    assert result.evaluation["decisions"] == 600
    assert result.evaluation["path_mm"] == 25


@pytest.mark.parametrize(("keeps_first", "kept"), [(True, 0), (False, 100)])
def test_a_policy_to_start_from_stays_until_another_one_arrives(
    keeps_first: bool, kept: int, point_env: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcomes = iter([(False, 0.0), (False, 1.0), (True, 0.0)])

    def played(policy: Policy, envs: Any, seeds: Any, *, deterministic: bool, **_: Any) -> EvaluationResult:
        success, reward = next(outcomes) if deterministic else (True, 0.0)
        return EvaluationResult((EpisodeOutcome(success, 10, reward, 5.0, 0.0, 0.0),))

    monkeypatch.setattr("enn.reinforcement.evaluation.run_episodes", played)
    policy = Training(dataclasses.replace(SMALL, decisions=16, evaluate_every=0), point_env, seed=0).run().policy
    best = BestPolicy(1, 0, keeps_first=keeps_first)
    for decisions in (0, 100):
        best.evaluate(policy, [], decisions)
    assert best.best is not None
    assert best.best["evaluation"]["decisions"] == kept
    best.evaluate(policy, [], 200)
    assert best.best["evaluation"]["decisions"] == 200


def test_stops_early_once_perfect_and_no_shorter(point_env: Any) -> None:
    settings = dataclasses.replace(SMALL, decisions=100_000, evaluate_every=200, stop_after=2)
    result = Training(settings, point_env, None, seed=1).run()
    assert result.timings["decisions"] < 4000
    assert result.evaluation is not None
    assert result.evaluation["success"] == 1.0


def test_a_few_hard_episodes_do_not_end_an_evaluation(point_env: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    played: list[int] = []

    def hard_first(policy: Policy, envs: Any, seeds: Any, *, deterministic: bool, **_: Any) -> EvaluationResult:
        played.append(len(seeds))
        return EvaluationResult(tuple(EpisodeOutcome(seed - 500_000 >= 4, 9, 0.0, 1.0, 0.0, 0.0) for seed in seeds))

    monkeypatch.setattr("enn.reinforcement.evaluation.run_episodes", hard_first)
    settings = dataclasses.replace(SMALL, decisions=400, evaluate_every=400, evaluation_episodes=24)
    result = Training(settings, point_env, seed=0).run()
    assert played == [6, 18, 24]
    assert result.evaluation is not None
    assert result.evaluation["success"] == pytest.approx(20 / 24)


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
    arrived: tuple[int, ...], kept: int, point_env: Any, monkeypatch: pytest.MonkeyPatch
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
    policy = Training(dataclasses.replace(SMALL, decisions=16, evaluate_every=0), point_env, seed=0).run().policy
    latest = LatestPolicy(16, 0)
    for number in range(len(arrived)):
        row = latest.evaluate(policy, [], number)
        assert row["evaluation_success"] == row["evaluation_stochastic_success"] == arrived[number] / 16
    assert latest.best is not None
    assert latest.best["evaluation"]["decisions"] == kept


@pytest.mark.parametrize(("keeps_first", "kept"), [(True, 0), (False, 1)])
def test_of_policies_that_never_arrive_the_first_or_the_best_rewarded_is_kept(
    keeps_first: bool, kept: int, point_env: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    rewards = iter([-3.0, -1.0, -2.0])

    def played(policy: Policy, envs: Any, seeds: Any, *, deterministic: bool, **_: Any) -> EvaluationResult:
        return EvaluationResult((EpisodeOutcome(False, 10, next(rewards), 5.0, 0.0, 0.0),))

    monkeypatch.setattr("enn.reinforcement.evaluation.run_episodes", played)
    policy = Training(dataclasses.replace(SMALL, decisions=16, evaluate_every=0), point_env, seed=0).run().policy
    latest = LatestPolicy(1, 0, keeps_first=keeps_first)
    for number in range(3):
        latest.evaluate(policy, [], number)
    assert latest.best is not None
    assert latest.best["evaluation"]["decisions"] == kept


def test_the_policy_that_a_training_starts_from_does_not_end_it_early(
    point_env: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def played(policy: Policy, envs: Any, seeds: Any, *, deterministic: bool, **_: Any) -> EvaluationResult:
        return EvaluationResult(tuple(EpisodeOutcome(True, 10, 1.0, 5.0, 0.0, 0.0) for _ in seeds))

    monkeypatch.setattr("enn.reinforcement.evaluation.run_episodes", played)
    policy = Training(dataclasses.replace(SMALL, decisions=16, evaluate_every=0), point_env, seed=0).run().policy
    latest = LatestPolicy(16, 0, keeps_first=True)
    counts = []
    for decisions in (0, 200, 400):
        latest.evaluate(policy, [], decisions)
        counts.append(latest.perfect)
    assert counts == [0, 1, 2]


def test_the_standard_error_of_all_successes_is_not_zero() -> None:
    assert 1 / 16 < standard_error(1.0, 16) < 2 / 16
    assert standard_error(0.5, 50) == pytest.approx(0.1)


def test_a_training_that_keeps_the_latest_draws_all_evaluated_actions(
    point_env: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    modes: set[bool] = set()

    def played(policy: Policy, envs: Any, seeds: Any, *, deterministic: bool, **_: Any) -> EvaluationResult:
        modes.add(deterministic)
        return run_episodes(policy, envs, seeds, deterministic=deterministic)

    monkeypatch.setattr("enn.reinforcement.evaluation.run_episodes", played)
    settings = dataclasses.replace(SMALL, decisions=600, keep_latest=True)
    result = Training(settings, point_env, seed=1).run()
    assert modes == {False}
    assert result.evaluation is not None
    assert result.evaluation["decisions"] == 600
