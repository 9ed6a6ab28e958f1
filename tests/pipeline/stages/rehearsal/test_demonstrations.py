"""Demonstrations in a rehearsal: who has a turn, what the episodes hold, that none is played twice."""

from __future__ import annotations

import dataclasses
import itertools
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from enn.device_trials import Tried
from enn.reinforcement.rehearsal_rules import Turn
from enn.trajectory import Trajectory
from pipeline.jobs.worker import Report
from pipeline.stages.rehearsal.copies import RehearsalJob, copies_environment
from pipeline.stages.rehearsal.stage import plan, shown_by
from pipeline.stages.rehearsal.start import advising_policies
from pipeline.stages.rehearsal.training import (
    demonstration_file,
    read_demonstrations,
    record_demonstrations,
    train,
    turn_of,
)
from pipeline.store.atomic_files import write_arrays
from pipeline.task import Task
from tests.pipeline.stages.rehearsal.small_rehearsal import GENERALIST, all_demonstrations, job_of
from tests.pipeline.stages.small_expert import context


def test_other_policies_are_asked_where_its_own_seldom_arrives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    task = Task(start_rotation_deg=180.0, max_steps=200)
    asked = advising_policies(tmp_path, 0, task, GENERALIST)
    assert [file.stem for file in asked] == ["generalist", "navigator", "navigator_seed1"]
    assert [file.stem for file in advising_policies(tmp_path, 0, Task(catheter="simmons2"), None)] == [
        "generalist_simmons2",
        "navigator_simmons2",
    ]
    assert [file.stem for file in advising_policies(tmp_path, 0, Task(catheter="jb2"), None)] == [
        "generalist_jb2",
        "navigator_jb2",
    ]

    job = dataclasses.replace(
        job_of(tmp_path, copies=2, demonstrations=4, task=task), start=GENERALIST, shown_by=tuple(asked)
    )
    # it arrives nearly always, so nobody else is asked
    assert all_demonstrations(job) == {"generalist": [3, 3]}
    shown = read_demonstrations(tmp_path)
    assert len(shown) == 3
    assert all(episode.terminated and episode.observations["roadmap"].shape[1] == 64 for episode in shown)
    assert {int(episode.simulation_states[0, -1]) for episode in shown} == {0, 1, 2}  # type: ignore[index]
    assert max(np.abs(episode.actions).max() for episode in shown) <= 1.0
    monkeypatch.setattr("enn.reinforcement.rehearsal.demonstrated", None)  # nothing is played again
    assert all_demonstrations(job) == {"generalist": [3, 3]}
    # the training takes them up
    train(dataclasses.replace(job, start=None), Report())
    record = json.loads((job.own_folder / "training.json").read_text())
    assert record["settings"]["demonstrations_in_replay"] == 0.25


@pytest.mark.parametrize(("reached", "others"), [(None, False), (4, False), (1, False), (0, True)])
def test_the_trials_of_the_devices_count_when_others_are_asked(
    tmp_path: Path, reached: int | None, others: bool
) -> None:
    """It arrives in both of two copies that one process plays, in three of four altogether: all of them count."""
    asked = tuple(advising_policies(tmp_path, 0, Task(), GENERALIST))[:2]
    job = job_of(tmp_path, copies=3, demonstrations=12)
    job = dataclasses.replace(job, start=GENERALIST, shown_by=asked, turn=1)
    job = dataclasses.replace(job, tried=None if reached is None else Tried(reached, 4, 100.0, 0.1))
    for place, copy in enumerate(job.training_cases):
        write_arrays(demonstration_file(job, "generalist", copy, 0), {"terminated": np.array(place < 3)})
    assert turn_of(job) == (Turn(asked[1]) if others else None)


def test_images_show_the_way_where_the_roadmap_fails_and_the_best_is_asked_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    played: list[tuple[str, int, int]] = []
    last = 9  # turn in which anybody arrives

    class Steered:
        def __init__(self, job: RehearsalJob, path: Path, copies: Any) -> None:
            self.path, self.environment = path, copies_environment(job, (0,))

        def episode(self, case: int, number: int) -> Trajectory:
            played.append((self.path.stem, case, number))
            arrives = self.path.stem == "navigator" and case == 2 and number <= last
            return Trajectory(
                {"roadmap": np.zeros((2, 64)), "history": np.zeros((2, 3))},
                np.zeros((1, 2)),
                np.zeros(1),
                arrives,
                np.zeros(1),
                np.zeros((2, 3)),
                np.full((2, 5), float(case)),
            )

    monkeypatch.setattr("pipeline.stages.rehearsal.training._Steered", Steered)
    asked = tuple(advising_policies(tmp_path, 0, Task(), GENERALIST))
    job = dataclasses.replace(job_of(tmp_path, copies=2, demonstrations=3), start=GENERALIST, shown_by=asked)
    assert all_demonstrations(job) == {"generalist": [3, 0], "navigator": [9, 3], "navigator_seed1": [3, 0]}
    turns = [("generalist", 0), ("navigator", 0), ("navigator_seed1", 0), ("navigator", 1), ("navigator", 2)]
    assert played == [(name, case, number) for name, number in turns for case in (0, 2, 1)]  # one part, then the other
    assert len(read_demonstrations(tmp_path)) == 3
    fewer = dataclasses.replace(job, settings=dataclasses.replace(job.settings, demonstrations=1))
    played.clear()
    assert all_demonstrations(fewer) == {"generalist": [3, 0], "navigator": [3, 1]}  # enough, so no third
    assert not played  # all of them were there
    last = 0
    alone = dataclasses.replace(job, folder=tmp_path / "alone")
    # a turn in which nobody arrives is the last one
    assert all_demonstrations(alone) == {"generalist": [3, 0], "navigator": [6, 1], "navigator_seed1": [3, 0]}


def test_turns_are_jobs_one_after_the_other_and_the_training_follows_them(tmp_path: Path) -> None:
    asked = advising_policies(tmp_path, 0, Task(), GENERALIST)
    settings = job_of(tmp_path, demonstrations=6).settings
    jobs = plan(settings, context(tmp_path, "rehearsal"), settings.task, "bca", GENERALIST, asked)
    after = {one.key: one.after for one in jobs}
    turns = [f"demonstrations/{turn}" for turn in range(6)]  # of three policies, and three more of the best
    assert after["training"] == tuple(f"{turn}/{part}" for turn in turns for part in range(2))
    for earlier, later in itertools.pairwise(turns):
        assert after[f"{later}/0"] == after[f"{later}/1"] == (f"{earlier}/0", f"{earlier}/1")
    assert shown_by(
        {"demonstrations/0/0": {"navigator": [6, 3]}, "demonstrations/0/1": {"navigator": [4, 1], "generalist": [2, 0]}}
    ) == {
        "navigator": 4,
        "generalist": 0,
    }
    none = dataclasses.replace(settings, demonstrations=0)
    jobs = plan(none, context(tmp_path, "rehearsal"), none.task, "bca", GENERALIST, asked)
    assert {one.key: one.after for one in jobs}["training"] == ()


def test_policies_whose_files_have_one_name_are_told_apart(tmp_path: Path) -> None:
    same = [tmp_path / folder / "policy.pt" for folder in ("a", "b")]
    for file in same:
        file.parent.mkdir()
        shutil.copy(GENERALIST.with_name("generalist_simmons2.pt"), file)
    job = dataclasses.replace(job_of(tmp_path, copies=1, catheter="simmons2"), shown_by=tuple(same))
    assert all_demonstrations(job) == {"policy": [2, 0], "policy2": [2, 0]}  # after twelve steps
    assert len(list((tmp_path / "demonstrations").iterdir())) == 4


def test_a_navigator_by_images_plays_in_the_copies(tmp_path: Path) -> None:
    navigator = GENERALIST.with_name("navigator.pt")
    job = dataclasses.replace(job_of(tmp_path, copies=1, demonstrations=1), shown_by=(navigator,), part=0)
    assert record_demonstrations(job, Report()) == {"navigator": [1, 0]}  # twelve steps do not lead there
    assert [file.name for file in (tmp_path / "demonstrations").iterdir()] == ["navigator_0_0.npz"]
    assert read_demonstrations(tmp_path) == []
