"""Trainings of a rehearsal that go on from the one before."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from enn.reinforcement.evaluation import LatestPolicy
from enn.reinforcement.rehearsal_rules import RehearsalRules
from enn.reinforcement.training import TrainingResult
from pipeline.jobs.worker import Report
from pipeline.stages.rehearsal.training import train
from tests.pipeline.stages.rehearsal.small_rehearsal import GENERALIST, job_of


@pytest.mark.parametrize(
    ("shares", "further"),
    [((None, 0.2, 0.88), True), ((0.2, 0.9), False), ((0.95, 0.5, None), True), ((0.5, 0.0), False), ((None,), False)],
)
def test_a_training_whose_latest_episodes_sometimes_arrive_is_worth_another(
    shares: tuple[float | None, ...], further: bool
) -> None:
    curve = [{"success": share} for share in shares]
    result = TrainingResult(policy=None, curve=curve, timings={}, evaluation=None)  # type: ignore[arg-type]
    assert RehearsalRules().sometimes_arrives(result) == further


def test_a_further_training_starts_from_the_one_before_and_its_policy_is_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(RehearsalRules, "sometimes_arrives", lambda self, result: True)
    job = dataclasses.replace(job_of(tmp_path, share_of_decisions=0.5, further_trainings=2), start=GENERALIST)
    told: list[float] = []
    cost = train(job, Report(lambda message: told.append(message.fraction)))
    assert cost["further_trainings"] == 2
    assert cost["decisions"] == 48 + 24 + 24
    seed = tmp_path / "seed0"
    last = (seed / "further2/policy.pt").read_bytes()
    assert (seed / "policy.pt").read_bytes() == last
    settings = [json.loads((seed / name / "training.json").read_text())["settings"] for name in ("", "further1")]
    assert settings[1]["learning_rate"] == pytest.approx(2 * settings[0]["learning_rate"])
    assert told
    assert all(0 <= share <= 1 for share in told)

    (seed / "further2/training.json").unlink()  # as where it was interrupted
    assert train(job, Report())["decisions"] == cost["decisions"]
    assert (seed / "further2/policy.pt").read_bytes() == (seed / "policy.pt").read_bytes()


def test_what_was_played_to_choose_the_length_is_the_first_evaluation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, counts = list[bool](), {"play": 0, "evaluate": 0}

    def mostly_arrives(self: RehearsalRules, *given: Any) -> bool:
        elsewhere: Callable[[], Sequence[bool]] = given[-1]
        asked.extend(elsewhere())
        return True

    def count(name: str) -> None:
        method = getattr(LatestPolicy, name)

        def counted(self: LatestPolicy, *given: Any, **named: Any) -> Any:
            counts[name] += 1
            return method(self, *given, **named)

        monkeypatch.setattr(LatestPolicy, name, counted)

    count("play")
    count("evaluate")
    monkeypatch.setattr(RehearsalRules, "mostly_arrives", mostly_arrives)
    job = dataclasses.replace(job_of(tmp_path, share_of_decisions=0.5), start=GENERALIST)
    assert train(job, Report())["decisions"] == 24
    assert len(asked) == 2  # the scan and a copy
    assert counts["play"] == counts["evaluate"] > 1  # one of them before the training, which does not play it again
