"""The expert's score: computed beside the console, each task once."""

import threading
from typing import Any

import pytest

from cathsim.console.expert import ExpertScores, expert_score

TASK = {
    "phantom": "type_1", "target": "bca", "wire": "default", "catheter": None, "accuracy": "fast", "max_steps": 2,
    "seed": 0, "success_radius": 0.008, "most_force": None,
}  # fmt: skip


def test_the_task_s_radius_and_force_limit_are_the_experts_too() -> None:
    told: list[dict[str, Any]] = []
    wide = {"max_steps": 30, "success_radius": 0.18, "success": "straight"}
    assert expert_score({**TASK, **wide}, told.append)["success"]
    assert [one["steps"] for one in told] == list(range(1, len(told) + 1))
    stopped = expert_score({**TASK, "max_steps": 60, "most_force": 1e-6})
    assert stopped["metrics"]["steps"] < 60
    assert stopped["metrics"]["force_max"] >= 1e-6
    assert not stopped["success"]


def test_scores_come_from_a_process_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[dict[str, Any] | None] = []
    arrived = threading.Event()
    seen: list[dict[str, Any]] = []
    scores = ExpertScores(
        lambda task, score: (told.append(score), arrived.set()),  # type: ignore[func-returns-value]
        lambda task, progress: seen.append(progress),
    )
    assert scores.score(TASK) is None
    scores.ask(TASK)
    assert arrived.wait(120)
    assert scores.score(TASK) == told[0]
    assert 1 <= seen[0]["steps"] <= 2
    assert seen[0]["seconds"] > 0
    other = {**TASK, "target": "lcca"}
    scores.ask(other)
    scores.ask(TASK)
    assert len(told) == 1, "a known score is not computed again, also after another task"
    assert scores.score(TASK) == told[0]
    arrived.clear()
    wrong = {**TASK, "target": "nowhere"}
    scores.ask(wrong)
    assert arrived.wait(120)
    assert told[1:] == [None], "a task that fails has no score, and the one that was given up is not told"
    assert scores.score(wrong) is None
    scores.close()
