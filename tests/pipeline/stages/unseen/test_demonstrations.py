"""Demonstrations in training anatomies: what is kept, what reaches the training."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cathsim.planning import demonstration
from cathsim.planning.demonstration import demonstrate
from pipeline.jobs.worker import Report
from pipeline.stages.unseen.demonstrations import (
    DemonstrationsJob,
    read_demonstrations,
    record_demonstrations,
)
from pipeline.stages.unseen.task import ROADMAP_KEYS, UnseenTask
from pipeline.task import Task

TASK = UnseenTask(("bca", "lcca"), Task(wire_length_mm=312.0, max_steps=24))


def test_what_is_demonstrated_is_what_the_training_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    environment = TASK.training_environment((0,), ROADMAP_KEYS)
    made = demonstrate(environment, 1, ROADMAP_KEYS, hold=4, seed=3)

    tries = []
    monkeypatch.setattr(
        demonstration, "demonstrate", lambda *_, **__: tries.append(1) or {**made, "terminated": np.array(True)}
    )
    job = DemonstrationsJob(tmp_path, TASK, (0,), (0,), "lcca", hold=4, seed=3)
    assert record_demonstrations(job, Report()) == {"shown": 1, "reached": 1}
    assert record_demonstrations(job, Report()) == {"shown": 1, "reached": 1}
    assert len(tries) == 1  # what is there is not made again
    (read,) = read_demonstrations(tmp_path, (0, 7))
    np.testing.assert_array_equal(read.observations["roadmap"], made["roadmap"])
    np.testing.assert_array_equal(read.simulation_states, made["states"])
    assert read_demonstrations(tmp_path, (7,)) == []


def test_failures_are_kept_but_not_learnt_from(tmp_path: Path) -> None:
    job = DemonstrationsJob(
        tmp_path, replace(TASK, task=replace(TASK.task, max_steps=8)), (0,), (0,), "bca", hold=4, seed=0
    )
    assert record_demonstrations(job, Report()) == {"shown": 1, "reached": 0}
    assert [path.name for path in tmp_path.iterdir()] == ["bca_0.npz"]
    assert read_demonstrations(tmp_path, (0,)) == []
