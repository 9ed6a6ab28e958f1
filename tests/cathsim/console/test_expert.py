"""The expert's score: computed beside the console, each task once."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import pytest

from cathsim.console.expert import ExpertScores, expert_score

TASK = {
    "phantom": "type_1", "target": "bca", "wire": "default", "catheter": None, "accuracy": "fast", "max_steps": 2,
    "seed": 0,
}  # fmt: skip


def test_a_score_has_the_metrics_of_a_procedure() -> None:
    score = expert_score(TASK)
    assert (score["success"], score["time_s"]) == (False, pytest.approx(0.2))
    assert score["metrics"]["steps"] == 2
    assert score["metrics"]["path_length"] > 0


def test_scores_come_from_a_process_of_their_own(anatomy_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CATHSIM_CACHE", str(anatomy_cache))
    told: list[dict[str, Any] | None] = []
    arrived = threading.Event()
    scores = ExpertScores(lambda task, score: (told.append(score), arrived.set()))  # type: ignore[func-returns-value]
    assert scores.score(TASK) is None
    scores.ask(TASK)
    assert arrived.wait(120)
    assert scores.score(TASK) == told[0]
    scores.ask(TASK)
    assert len(told) == 1, "a known score is not computed again"
    scores.close()


def test_a_task_that_fails_has_no_score() -> None:
    told: list[dict[str, Any] | None] = []
    arrived = threading.Event()
    scores = ExpertScores(lambda task, score: (told.append(score), arrived.set()))  # type: ignore[func-returns-value]
    wrong = {**TASK, "target": "nowhere"}
    scores.ask(wrong)
    assert arrived.wait(120)
    assert told == [None]
    assert scores.score(wrong) is None
    scores.close()
