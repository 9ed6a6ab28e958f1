"""Demonstrations of a training: the expert's logs that fit its task, the others named and left out."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest

from pipeline.recording.record import record_episode
from pipeline.stages.enn import plan
from pipeline.stages.learning import plan as training_plan
from pipeline.stages.learning.settings import EnnSettings
from pipeline.stages.learning.task import LearningTask
from pipeline.stages.learning.training import repeat
from pipeline.task import Task
from tests.pipeline.stages.small_expert import context

TASK = LearningTask("type_1", "bca", Task(max_steps=3))


def record(path: Path, wire: str = "default") -> Path:
    environment = LearningTask("type_1", "bca", Task(wire=wire, max_steps=3)).environment("tip")
    record_episode(
        environment, lambda observation, info: np.array([1.0, 0.0]), path, seed=0, operator="test", pictures=False
    )
    return path


def test_another_wire_and_damage_are_left_out_by_name(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    logs = [record(tmp_path / "000.mcap"), record(tmp_path / "001.mcap", "thesis"), tmp_path / "002.mcap"]
    logs[2].write_bytes(logs[0].read_bytes()[:3000])
    (found,) = repeat(logs, TASK)
    assert found.metadata["file"] == str(logs[0])
    assert found.simulation_states is not None
    wire, damage = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert wire == f"{logs[1]} is left out: it was recorded with another wire or catheter than default"
    assert damage.startswith(f"{logs[2]} is left out: ")


def test_an_empty_folder_of_the_expert_is_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: list[str] = []

    def no_work(folder, jobs, **_):
        ran.extend(job.key for job in jobs)
        return {job.key: {"wall_s": 0.0} for job in jobs}

    monkeypatch.setattr(training_plan, "run_jobs", no_work)
    settings = EnnSettings(phantoms=["type_1"], targets=["bca", "lcca"])
    record(tmp_path / "expert/type_1/lcca/000.mcap")
    place = context(tmp_path, "enn", ("expert",))
    training_plan.run_trainings(plan(settings, place), settings, place)
    assert "type_1/bca/I+V+M/seed0" in ran
    (warning,) = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert warning.startswith("there are no expert episodes of type_1/bca, so it is learnt without demonstrations")
