"""A procedure: what a human does is the environment's episode, recorded step by step."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cathsim.console import CRITERIA, NpzRecorder
from cathsim.console.operator_setup import ForceLimit
from cathsim.console.procedure import ENDED, READY, RUNNING, Procedure, devices_between
from cathsim.console.recorder import episode_path
from cathsim.console.xray.room import XRayStep
from cathsim.devices.pair import wire_and_catheter
from tests.cathsim.makers import MakeEnv

ANSWERS = {**{criterion.key: 4 for criterion in CRITERIA}, "participant": "P7"}


def test_it_is_the_environments_episode(make_env: MakeEnv, memory: Any) -> None:
    procedure = Procedure(make_env(max_steps=12), memory, seed=5)
    assert procedure.state == READY
    actions = np.random.default_rng(0).uniform(-0.2, 1.0, (12, 2)).astype(np.float32)
    for action in actions:
        procedure.step(*action.tolist())
        assert procedure.state == (RUNNING if procedure.steps < 12 else ENDED)
    env = make_env(max_steps=12)
    _, info = env.reset(seed=5)
    tips = [info["tip"], *(env.step(action)[-1]["tip"] for action in actions)]
    episode = memory.episodes[0]
    np.testing.assert_array_equal(episode["tips"], tips)
    np.testing.assert_array_equal(episode["actions"], actions)
    assert (episode["state"], episode["seed"]) == ("finished", 5)
    assert episode["metrics"].steps == 12
    assert not procedure.success
    with pytest.raises(RuntimeError, match="has ended"):
        procedure.step(1.0, 0.0)


def test_a_procedure_may_end_at_the_force_limit(make_env: MakeEnv, tmp_path: Path) -> None:
    recorder = NpzRecorder(tmp_path)
    procedure = Procedure(make_env(max_steps=200), recorder, seed=0, force_limit=ForceLimit(0.05, ends=True))
    while procedure.state != ENDED:
        procedure.step(1.0, 0.0)
    assert procedure.stopped
    assert (procedure.success, procedure.invalid) == (False, False)
    forces = [sample.force for sample in procedure.samples]
    assert forces[-1] >= 0.05 > max(forces[:-1])
    with np.load(procedure.path) as file:
        description = json.loads(str(file["description"]))
        assert file["force_warning"].tolist() == [False] * (procedure.steps - 1) + [True]
    assert (description["force_limit"], description["ends_at_force_limit"]) == (0.05, True)
    assert description["totals"]["force_warnings"] == 1
    assert description["metrics"]["steps"] == procedure.steps < 200


def test_broken_off_it_has_no_metrics_and_untouched_no_file(make_env: MakeEnv, memory: Any) -> None:
    env = make_env()
    procedure = Procedure(env, memory, seed=0)
    procedure.break_off()
    assert procedure.path is None
    second = Procedure(env, memory, seed=1)
    second.step(1.0, 0.0)
    second.break_off()
    second.break_off()
    assert memory.episodes[1]["state"] == "broken off"
    assert second.path == Path("1.memory")
    assert second.answer(ANSWERS) == Path("1.memory")
    assert memory.episodes[1]["answers"] == ANSWERS


def test_a_recorder_that_fails_does_not_stop_the_operator(make_env: MakeEnv, memory: Any) -> None:
    memory.fails_at = 2
    procedure = Procedure(make_env(max_steps=5), memory, seed=0)
    for _ in range(5):
        procedure.step(1.0, 0.0)
    assert procedure.state == ENDED
    assert procedure.trouble == "this episode is not recorded: disk full"
    assert procedure.path is None
    assert len(memory.episodes[0]["actions"]) == 2


def test_npz_episode_is_read_back(make_env: MakeEnv, tmp_path: Path) -> None:
    recorder = NpzRecorder(tmp_path)
    procedure = Procedure(make_env(max_steps=6, target="lcca"), recorder, seed=3)
    for step in range(6):
        procedure.step(1.0, 0.25, xray=XRayStep(on=step < 4, injections=int(step == 1)))
    path = tmp_path / "type_1" / "lcca" / "000.npz"
    assert procedure.path == path
    with np.load(path) as file:
        description = json.loads(str(file["description"]))
        assert file["action"].tolist() == [[1.0, 0.25]] * 6
        assert file["wire_points"].shape == (7, 29, 3)
        np.testing.assert_array_equal(file["wire_points"][-1], procedure.samples[-1].points)
        assert [file[name].shape[0] for name in ("reward", "tip", "force", "insertion", "rotation")] == [6, 7, 7, 7, 7]
        assert file["xray_on"].tolist() == [True] * 4 + [False] * 2
        assert file["injections"].tolist() == [0, 1, 0, 0, 0, 0]
    assert description["totals"] == {"fluoroscopy_time_s": 0.4, "injections": 1, "force_warnings": 0}
    assert description["operator"] == "human"
    assert (description["devices"]["wire"], description["devices"]["catheter"]) == ("default", None)
    assert (description["phantom"], description["seed"], description["metrics"]["steps"]) == ("type_1", 3, 6)
    beside = procedure.answer(ANSWERS)
    assert beside == path.with_name("000.questionnaire.json")
    content = json.loads(beside.read_text())
    assert content == {"episode": "000.npz", "operator": "human", "answers": ANSWERS}


def test_two_devices_are_steered_shown_and_kept(make_env: MakeEnv, tmp_path: Path) -> None:
    env = make_env(max_steps=5, catheter="simmons2")
    procedure = Procedure(env, NpzRecorder(tmp_path), seed=3)
    actions = np.array([[1, 0, 0.5, 0], [1, 1, 1, 0], [1, 0, -0.5, 1], [0.5, 0, 0, -1], [1, 0, 0, 0]], np.float32)
    for advance, rotate, *catheter in actions.tolist():
        procedure.step(advance, rotate, (catheter[0], catheter[1]))
    again = make_env(max_steps=5, catheter="simmons2")
    again.reset(seed=3)
    tips = [again.step(action)[-1]["tip"] for action in actions]
    np.testing.assert_array_equal([sample.points[0] for sample in procedure.samples[1:]], tips)

    earlier, later = procedure.samples[-2:]
    links = env.simulation.wire.links
    wire, catheter = devices_between(earlier, later, 1.0, links)
    np.testing.assert_array_equal(wire, env.simulation.device_points("wire"))
    np.testing.assert_array_equal(catheter, env.simulation.device_points("catheter"))
    assert later.devices.lead == pytest.approx(later.insertion - later.devices.catheter_insertion)
    assert later.devices.feeder_forces == tuple(env.simulation.feeder_forces())
    before, _ = devices_between(earlier, later, 0.0, links)
    half, _ = devices_between(earlier, later, 0.5, links)
    assert before[0, 2] < half[0, 2] < wire[0, 2], "the wire goes on between two steps"

    with np.load(procedure.path) as file:
        description = json.loads(str(file["description"]))
        np.testing.assert_array_equal(file["action"], actions)
        kept = wire_and_catheter(file["wire_points"][-1], description["devices"]["links"], float(file["lead"][-1]))
        assert file["feeder_forces"].shape == (6, 2)
        np.testing.assert_allclose(file["insertion"] - file["catheter_insertion"], file["lead"], atol=1e-9)
        assert file["catheter_rotation"][-1] == pytest.approx(later.devices.catheter_rotation)
    np.testing.assert_array_equal(kept[0], wire)
    np.testing.assert_array_equal(kept[1], catheter)
    devices = description["devices"]
    assert (devices["wire"], devices["catheter"]) == ("default", "simmons2")
    assert devices["catheter_settings"]["outer_diameter"] == env.simulation.pair.catheter.outer_diameter


def test_numbers_go_on_after_the_highest_also_of_unfinished_files(tmp_path: Path) -> None:
    assert episode_path(tmp_path, "type_1", "bca", ".npz").name == "000.npz"
    folder = tmp_path / "type_1" / "bca"
    folder.mkdir(parents=True)
    for name in ("000.npz", "007.npz.partial", "notes.txt"):
        (folder / name).touch()
    assert episode_path(tmp_path, "type_1", "bca", ".npz") == folder / "008.npz"
