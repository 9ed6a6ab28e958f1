"""Demonstrations of a training: the expert's logs that fit its task, the others named and left out."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

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
EXPERT_ALONE: dict[str, Any] = {"phantoms": ["type_1"], "modalities": [], "safe_weights": [], "seeds": 1}


def record(path: Path, **task: str) -> Path:
    environment = LearningTask("type_1", "bca", Task(max_steps=3, **task)).environment("tip")
    action = np.tile([1.0, 0.0], environment.action_space.shape[0] // 2)
    record_episode(environment, lambda *_: action, path, seed=0, operator="test", pictures=False)
    return path


def test_only_trainings_are_in_the_fast_physics() -> None:
    """Tables are of accurate physics, whatever a training had."""
    place = {"phantoms": ["type_1"], "targets": ["bca"]}
    task = training_plan.task_of(EnnSettings(**place, accuracy="fast"), "type_1", "bca")
    assert training_plan.task_of(EnnSettings(**place, accuracy="accurate"), "type_1", "bca").accuracy == "accurate"
    training, test = task.environment("tip", training=True), task.environment("tip")
    usual = TASK.environment("tip")
    timesteps = [one.simulation.model.opt.timestep for one in (training, test, usual)]
    assert timesteps[0] > timesteps[1] == timesteps[2]


def test_another_wire_and_damage_are_left_out_by_name(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    logs = [record(tmp_path / "000.mcap"), record(tmp_path / "001.mcap", wire="thesis"), tmp_path / "002.mcap"]
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
        return {job.key: {"joints+image+mask": {"wall_s": 0.0}} for job in jobs}

    monkeypatch.setattr(training_plan, "run_jobs", no_work)
    settings = EnnSettings(**EXPERT_ALONE, targets=["bca", "lcca"])
    record(tmp_path / "expert/type_1/lcca/000.mcap")
    place = context(tmp_path, "enn", ("expert",))
    training_plan.run_trainings(plan(settings, place), settings, place)
    assert "type_1/bca/I+V+M/seed0" in ran
    assert ran.count("encoders/type_1") == 1
    (warning,) = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert warning.startswith("there are no expert episodes of type_1/bca, so it is learnt without demonstrations")


def test_demonstrations_with_a_catheter_are_for_that_catheter(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    logs = [record(tmp_path / "000.mcap", catheter="vertebral"), record(tmp_path / "001.mcap")]
    pair = replace(TASK, task=replace(TASK.task, catheter="vertebral"))
    (found,) = repeat(logs, pair, ("joints", "feeder"))
    assert found.actions.shape == (3, 4)
    assert found.observations["feeder"].shape == (4, 7)
    assert found.simulation_states is not None
    environment = pair.environment("tip")
    environment.reset(seed=0, options={"start": found.simulation_states[2]})
    np.testing.assert_array_equal(environment.simulation.tip, found.tips[2])
    (bare,) = repeat(logs, TASK)
    assert bare.metadata["file"] == str(logs[1])
    assert not repeat(logs, replace(TASK, task=replace(pair.task, torsion="rigid")))
    told = [record.getMessage() for record in caplog.records]
    assert told[0] == f"{logs[1]} is left out: it was recorded with another wire or catheter than default in vertebral"


def test_a_policy_of_two_devices_sees_the_feeders(tmp_path: Path) -> None:
    settings = EnnSettings(**EXPERT_ALONE, targets=["bca"], catheter="vertebral")
    (job,) = plan(settings, context(tmp_path, "enn", ("expert",)))
    assert job.keys == ("joints", "image", "mask", "feeder")
    assert job.encoder is not None
    assert job.encoder.name == "joints+image+mask+feeder.pt"
    assert job.task.task.catheter == "vertebral"
