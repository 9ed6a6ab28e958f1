"""The policy that a rehearsal starts from: which one, and the devices that come with one that is given."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from enn.shipped import weight_files
from pipeline.stages.rehearsal.settings import RehearsalSettings
from pipeline.stages.rehearsal.stage import run_rehearsal
from pipeline.stages.rehearsal.starting_policy import (
    advising_policies,
    policy_hashes,
    starting_policy,
    with_devices_of,
)
from pipeline.store.errors import ConfigurationError
from pipeline.task import Task
from tests.pipeline.stages.rehearsal.small_rehearsal import GENERALIST, TINY
from tests.pipeline.stages.small_expert import context

OF_SIMMONS = next(file for file in weight_files() if file.stem == "generalist_simmons2")


def test_the_policy_of_the_run_comes_before_a_shipped_one(tmp_path: Path) -> None:
    alone, shipped = Task(), GENERALIST
    assert starting_policy(RehearsalSettings(), tmp_path, 0, alone) == shipped
    file = tmp_path / "unseen/roadmap/seed0/policy.pt"
    file.parent.mkdir(parents=True)
    shutil.copy(shipped, file)
    assert starting_policy(RehearsalSettings(), tmp_path, 0, alone) == file
    hashes = policy_hashes(tmp_path)
    assert hashes["unseen/roadmap/seed0/policy.pt"] == hashes[f"shipped/{shipped.name}"]
    assert policy_hashes(tmp_path / "elsewhere") == {k: v for k, v in hashes.items() if k.startswith("shipped/")}
    assert starting_policy(RehearsalSettings(fresh=True), tmp_path, 0, alone) is None
    assert starting_policy(RehearsalSettings(policy=str(shipped)), tmp_path, 0, alone) == shipped
    file.write_bytes(b"x")
    with pytest.raises(ValueError, match=r"policy\.pt"):
        starting_policy(RehearsalSettings(), tmp_path, 0, alone)


def test_a_policy_of_other_actions_is_not_started_from(tmp_path: Path) -> None:
    assert starting_policy(RehearsalSettings(), tmp_path, 0, Task(pace="arch_variety")) is None  # without critics
    for task in (Task(catheter="jb2", wire="none"), Task(actions="tip_motors")):
        assert starting_policy(RehearsalSettings(), tmp_path, 0, task) is None
        assert advising_policies(tmp_path, 0, task, None) == []
    assert starting_policy(RehearsalSettings(algorithm="ppo"), tmp_path, 0, Task()) is None


def test_a_catheter_without_a_policy_is_steered_by_those_of_others(tmp_path: Path) -> None:
    asked = {}
    for catheter in ("simmons2", "simmons2_4f", "vertebral"):
        task = Task(catheter=catheter)
        start = starting_policy(RehearsalSettings(), tmp_path, 0, task)
        asked[catheter] = [path.stem for path in advising_policies(tmp_path, 0, task, start)]
    assert asked["simmons2"] == ["generalist_simmons2", "navigator_simmons2"]  # a catheter's own policies are enough
    assert asked["simmons2_4f"] == asked["simmons2"]  # of the same shape in another size
    assert asked["vertebral"] == ["generalist_jb2", "generalist_simmons2"]


def test_a_given_policy_brings_its_catheter_where_none_is_named() -> None:
    assert with_devices_of(GENERALIST, Task()) == Task()
    assert with_devices_of(OF_SIMMONS, Task(max_steps=7)) == Task(catheter="simmons2", max_steps=7)
    assert with_devices_of(OF_SIMMONS, Task(catheter="jb2")) == Task(catheter="jb2")


def test_a_given_policy_of_a_wire_alone_does_not_steer_a_catheter(tmp_path: Path) -> None:
    settings = RehearsalSettings(**TINY | {"policy": str(GENERALIST), "catheter": "jb2"})
    with pytest.raises(ConfigurationError, match="steers a wire alone, the task has a catheter, too: give another"):
        run_rehearsal(settings, context(tmp_path, "rehearsal"))
