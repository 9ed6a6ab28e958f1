"""How long a chain takes: what is known of a budget, and what this machine's pace makes of it."""

from __future__ import annotations

import time

import pytest

from pipeline.chain import durations, pace
from pipeline.chain.durations import known_minutes, minutes_here, minutes_left, worded
from pipeline.chain.pace import machine_seconds
from pipeline.config import BUDGETS
from pipeline.stages import available_stages


def test_the_estimate_follows_the_machine() -> None:
    known = {"phantoms": 1.0, "enn": 40.0, "unseen": 60.0}
    assert minutes_left(["unseen"], [], [], known) == pytest.approx(60.0)
    twice_as_slow = minutes_left(["unseen"], [], [("enn", 80.0)], known)
    assert twice_as_slow is not None
    assert 110 < twice_as_slow < 120
    # a short stage says little, one that was up to date nothing
    after_short = minutes_left(["unseen"], [], [("phantoms", 2.0)], known)
    assert after_short is not None
    assert 60 < after_short < 85
    assert minutes_left(["unseen"], [], [("enn", 0.1)], known) == pytest.approx(60.0)
    assert minutes_left(["unseen", "shape"], [], [], known) is None


def test_minutes_are_those_of_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    known = known_minutes(["budget=desk"])
    reference = durations.of_budget("desk")["machine_seconds"]
    monkeypatch.setattr(durations, "machine_seconds", lambda: 1.5 * reference)
    here, ratio = minutes_here(available_stages(), ["budget=desk"])
    assert ratio == pytest.approx(1.5)
    assert here == pytest.approx({name: 1.5 * minutes for name, minutes in known.items()})
    monkeypatch.setattr(durations, "machine_seconds", lambda: None)  # it could not be measured
    assert minutes_here(available_stages(), ["budget=desk"]) == (known, 1.0)


def test_a_short_chain_measures_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(durations, "machine_seconds", lambda: pytest.fail("measured"))
    assert minutes_here(["phantoms", "report"], ["budget=desk"])[1] == 1.0
    assert minutes_here(available_stages(), ["budget=smoke"])[1] == 1.0
    assert minutes_here(available_stages(), ["budget=none"]) == ({}, 1.0)


def test_the_machine_is_measured() -> None:
    seconds = machine_seconds()
    assert seconds is not None
    assert 0.05 < seconds < 60


def test_time_that_the_workload_waits_for_others_is_not_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pace, "_training_step", lambda: lambda: time.sleep(0.05))
    monkeypatch.setattr("mujoco.mj_step", lambda *_: None)
    assert pace.alone() < 0.05 * pace._TRAINING_STEPS / 2


def test_what_stages_under_way_have_done_is_not_left() -> None:
    known = {"enn": 40.0, "unseen": 60.0, "shape": 20.0}
    assert minutes_left(["shape"], [("enn", 10.0), ("unseen", 10.0)], [], known) == pytest.approx(30 + 50 + 20)
    # one that lasts longer than known may end at any moment
    assert minutes_left(["shape"], [("enn", 50.0)], [], known) == pytest.approx(20.0)
    assert minutes_left([], [("phantoms", 1.0)], [], known) is None


@pytest.mark.parametrize("budget", ["smoke", "desk"])
def test_every_stage_of_measured_budgets_is_known(budget: str) -> None:
    assert set(known_minutes([f"budget={budget}"])) == set(available_stages())


def test_what_was_not_measured_is_not_guessed() -> None:
    assert known_minutes(["budget=none"]) == {}
    assert all(isinstance(known_minutes([f"budget={budget}"]), dict) for budget in BUDGETS)
    assert known_minutes([]) == known_minutes(["budget=desk"])


@pytest.mark.parametrize(
    ("minutes", "words"), [(0.5, "30 s"), (12.4, "12 min"), (59.6, "1 h 00 min"), (125, "2 h 05 min")]
)
def test_durations_are_worded(minutes: float, words: str) -> None:
    assert worded(minutes) == words
