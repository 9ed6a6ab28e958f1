"""Demonstrations of a training: the expert's logs that fit its task, the others named and left out."""

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from enn.encoder import Encoder, EncoderSettings
from enn.reinforcement.training.settings import DESK_PPO, DESK_SAC
from pipeline.jobs.worker import Report
from pipeline.recording.record import record_episode
from pipeline.stages.baselines import training_settings as of_baselines
from pipeline.stages.enn import plan
from pipeline.stages.enn import training_settings as of_enn
from pipeline.stages.learning import encoders
from pipeline.stages.learning import training as training_plan
from pipeline.stages.learning.encoders import EncodersJob, encoder_file, fit_encoders
from pipeline.stages.learning.expert_episodes import repeat
from pipeline.stages.learning.settings import BaselinesSettings, EnnSettings, with_hyperparameters
from pipeline.stages.learning.task import LearningTask
from pipeline.stages.unseen.roadmap import training_settings as of_unseen
from pipeline.stages.unseen.settings import UnseenSettings
from pipeline.store.errors import ConfigurationError
from pipeline.task import Task
from tests.pipeline.composed import composed
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
    assert wire.startswith(f"{logs[1]} is left out: ")
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
    assert "no expert episodes of type_1/bca" in warning


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
    assert caplog.messages[0].startswith(f"{logs[1]} is left out: ")


def test_a_policy_of_two_devices_sees_the_feeders(tmp_path: Path) -> None:
    settings = EnnSettings(**EXPERT_ALONE, targets=["bca"], task=Task(catheter="vertebral"))
    (job,) = plan(settings, context(tmp_path, "enn", ("expert",)))
    assert job.keys == ("joints", "image", "mask", "feeder")
    assert job.encoder is not None
    assert job.encoder.name == "joints+image+mask+feeder.pt"
    assert job.task.task.catheter == "vertebral"


SETS = (("joints", "image"), ("image", "feeder"))


def job(folder: Path, *sets: tuple[str, ...]) -> EncodersJob:
    task = LearningTask("type_1", "bca", Task(image_size_px=36))
    return EncodersJob(folder, task, sets, EncoderSettings(epochs=1, seed=3), 120, ())


def test_encoders_are_as_if_alone_and_one_that_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told = fit_encoders(job(tmp_path / "both", *SETS), Report())
    assert list(told) == ["joints+image", "image+feeder"]
    alone = tmp_path / "alone"
    first = fit_encoders(job(alone, SETS[0]), Report())
    before = encoder_file(alone, SETS[0]).read_bytes()
    asked = []
    samples = encoders._samples

    def only_what_lacks(given, sets, report):
        asked.extend(sets)
        return samples(given, sets, report)

    monkeypatch.setattr(encoders, "_samples", only_what_lacks)
    both = fit_encoders(job(alone, *SETS), Report())
    assert asked == [SETS[1]]
    assert encoder_file(alone, SETS[0]).read_bytes() == before
    assert both["joints+image"] == first["joints+image"]
    assert fit_encoders(job(alone, *SETS), Report()) == both
    assert asked == [SETS[1]]
    for keys, name in zip(SETS, told, strict=True):
        assert [key for key, value in told[name].items() if value != both[name][key] and not key.endswith("_s")] == []
        one, other = (Encoder.load(encoder_file(tmp_path / place, keys)).state_dict() for place in ("both", "alone"))
        assert one.keys() == other.keys()
        assert all(torch.equal(one[part], other[part]) for part in one)


PLACE = {"phantoms": ["type_1"], "targets": ["bca"]}
CHANGES = {"learning_rate": 3e-4, "n_envs": 4, "hidden": [32, 32]}


def test_every_learning_stage_takes_them_and_without_any_nothing_changes() -> None:
    made = [
        of_baselines(BaselinesSettings(**PLACE, training=CHANGES), "ppo", "internal"),
        of_enn(EnnSettings(**PLACE, training=CHANGES), 500),
        of_enn(EnnSettings(**PLACE, training=CHANGES, algorithm="ppo"), 500),
        of_unseen(UnseenSettings(training=CHANGES), 4, 1000),
    ]
    assert [one.algorithm for one in made] == ["ppo", "sac", "ppo", "sac"]
    for training in made:
        assert (training.learning_rate, training.n_envs, training.hidden) == (3e-4, 4, (32, 32))
    assert with_hyperparameters(DESK_SAC, None) is with_hyperparameters(DESK_SAC, {}) is DESK_SAC
    with pytest.raises(ConfigurationError, match=r"stage\.training must be a mapping"):
        EnnSettings(**PLACE, training=[1])


@pytest.mark.parametrize("stage", ["baselines", "enn", "unseen", "rehearsal"])
def test_the_command_line_takes_them(stage: str) -> None:
    stage = composed(f"stage={stage}", "stage.training={learning_rate: 3e-4, hidden: [32, 32]}").stage
    assert stage.training == {"learning_rate": 3e-4, "hidden": [32, 32]}


@pytest.mark.parametrize(
    ("preset", "changes", "message"),
    [
        (DESK_SAC, {"decisions": 5}, "stage.training has no 'decisions': choose from .*learning_rate"),
        (DESK_SAC, {"gamma": 2.0}, "stage.training: .*gamma"),
        (DESK_PPO, {"tau": 0.1}, "stage.training has no 'tau': choose from .*gae_lambda"),
    ],
)
def test_what_cannot_be_is_one_sentence(preset: Any, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        with_hyperparameters(preset, changes)
