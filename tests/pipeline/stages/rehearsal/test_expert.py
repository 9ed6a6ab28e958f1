"""Demonstrations of the sampling expert in a rehearsal: when it is asked, what it leaves, when it gives up."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from enn.reinforcement.rehearsal_rules import Turn
from pipeline.jobs.worker import Report
from pipeline.stages.rehearsal.stage import plan
from pipeline.stages.rehearsal.training import (
    demonstration_file,
    read_demonstrations,
    record_demonstrations,
    train,
    turn_of,
)
from pipeline.store.atomic_files import write_arrays
from pipeline.task import Task
from tests.pipeline.stages.rehearsal.small_rehearsal import GENERALIST, job_of
from tests.pipeline.stages.small_expert import context


def test_the_sampling_expert_shows_the_way_where_no_policy_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    task = Task(start_rotation_deg=180.0, max_steps=300)
    job = job_of(tmp_path, copies=1, demonstrations=2, expert="needed", task=task)
    assert record_demonstrations(job, Report()) == {"expert": [1, 1]}  # the scan is this part's
    (shown,) = read_demonstrations(tmp_path)
    assert shown.terminated
    assert len(shown.actions) == len(shown.rewards) == len(shown.simulation_states) - 1
    assert shown.simulation_states[0, -1] == 0  # the case
    monkeypatch.setattr("cathsim.planning.demonstration.demonstrate", None)  # nothing is played again
    assert record_demonstrations(job, Report()) == {"expert": [1, 1]}
    always = dataclasses.replace(job.settings, expert="always")  # enough is shown, so that no policy is asked
    always = dataclasses.replace(always, demonstrations=1)
    asked = dataclasses.replace(job, settings=always, start=GENERALIST, shown_by=(GENERALIST,))
    assert turn_of(asked) == Turn(None)
    assert turn_of(dataclasses.replace(asked, turn=1)) is None
    trained = train(job, Report())
    assert trained["decisions"] == 48
    record = json.loads((tmp_path / "seed0" / "training.json").read_text())
    assert record["settings"]["demonstrations_in_replay"] == 0.25
    jobs = plan(job.settings, context(tmp_path, "rehearsal"), task, "bca", None)
    assert {one.key: one.after for one in jobs}["training"] == ("demonstrations/0/0", "demonstrations/0/1")
    alone = dataclasses.replace(job.settings, expert="never")
    jobs = plan(alone, context(tmp_path, "rehearsal"), task, "bca", None)
    assert {one.key: one.after for one in jobs}["training"] == ()


@pytest.mark.parametrize(("arriving", "expert"), [(0, True), (1, True), (2, False)])
def test_the_expert_is_asked_where_policies_show_next_to_nothing(tmp_path: Path, arriving: int, expert: bool) -> None:
    """Of six episodes that are wanted a third is enough."""
    job = job_of(tmp_path, copies=5, demonstrations=6, expert="needed")
    job = dataclasses.replace(job, start=GENERALIST, shown_by=(GENERALIST,))
    for number in range(2):
        for place, copy in enumerate(job.training_cases):
            file = demonstration_file(job, "generalist", copy, number)
            write_arrays(file, {"terminated": np.array(number == 0 and place < arriving)})
    number = 2 if arriving else 1  # a turn in which nobody arrives is the last one of policies
    assert turn_of(dataclasses.replace(job, turn=number)) == (Turn(None) if expert else None)
    assert turn_of(dataclasses.replace(job, turn=number + 1)) is None


def test_the_expert_gives_up_where_it_does_not_arrive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    failed, gentle = {"terminated": np.array(False), "actions": np.zeros((3, 2))}, list[bool]()

    def fail(*_: object, **given: Any) -> dict[str, np.ndarray]:
        gentle.append(given["gentle"])
        return failed

    monkeypatch.setattr("cathsim.planning.demonstration.demonstrate", fail)
    job = dataclasses.replace(job_of(tmp_path, copies=13, demonstrations=4, expert="needed"), part=1)
    assert record_demonstrations(job, Report()) == {"expert": [8, 0]}
    assert gentle == [True] * 5 + [False] * 3
    assert read_demonstrations(tmp_path) == []


@pytest.mark.parametrize(("arriving", "told", "usual"), [(1, [14, 7], True), (3, [7, 3], False)])
def test_it_plays_as_usual_where_few_gentle_episodes_arrive(
    tmp_path: Path, arriving: int, told: list[int], usual: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of seven copies the gentle one arrives in the first so many, the usual one in all but the first."""

    def play(_: object, case: int, *__: object, gentle: bool, **___: object) -> dict[str, np.ndarray]:
        number = (case - 1) // 2  # of the second part
        return {"terminated": np.array(number < arriving if gentle else number > 0)}

    monkeypatch.setattr("cathsim.planning.demonstration.demonstrate", play)
    job = dataclasses.replace(job_of(tmp_path, copies=14, demonstrations=20, expert="needed"), part=1)
    assert record_demonstrations(job, Report()) == {"expert": told}
    assert bool(list((tmp_path / "demonstrations").glob("expert_*_1.npz"))) == usual
