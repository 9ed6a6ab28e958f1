"""What a rehearsal starts from: devices by trials of policies, the policy, and what a newton costs."""

from __future__ import annotations

import dataclasses
import logging
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from cathsim import load_phantom
from enn.device_trials import Trial, Tried, try_in_copies
from enn.shipped import weight_files
from pipeline.jobs.worker import Report
from pipeline.seeds import training_copies
from pipeline.stages.rehearsal import start
from pipeline.stages.rehearsal.settings import RehearsalSettings
from pipeline.stages.rehearsal.stage import run_rehearsal
from pipeline.stages.rehearsal.start import (
    advising_policies,
    policy_hashes,
    starting_policy,
    try_devices,
    with_chosen_devices,
    with_devices_of,
)
from pipeline.store.errors import ConfigurationError
from pipeline.task import Task
from tests.pipeline.stages.rehearsal.small_rehearsal import GENERALIST, TINY
from tests.pipeline.stages.small_expert import context

BY_SHAPE = Task(catheter="pigtail")  # what nothing else gives
Outcomes = dict[str, Tried]


@pytest.fixture
def chosen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Chooses with trials that end as said; also which were asked for, call by call."""
    asked: list[list[str]] = []
    phantom = load_phantom("type_1")

    def choose(
        outcomes: Outcomes, task: Task | None = None, target: str = "lcca", **changed: Any
    ) -> tuple[Task, Tried | None]:
        asked.clear()

        def run(folder: Any, jobs: Any, **_: Any) -> dict[str, Any]:
            assert [job.given.part % 2 for job in jobs] == [0, 1] * (len(jobs) // 2)
            asked.append([job.key for job in jobs[::2]])
            return {job.key: [job.key.split("/")[1]] for job in jobs}

        class Told:  # what the trials come to
            @staticmethod
            def of(trials: list[str]) -> Tried:
                assert set(trials) == {trials[0]}
                return outcomes[trials[0] + " again" * (len(trials) > 2)]

        monkeypatch.setattr(start, "run_jobs", run)
        monkeypatch.setattr("enn.device_trials.Tried", Told)
        monkeypatch.setattr(start, "with_catheter_where_steep", lambda *_, choose: BY_SHAPE)
        settings = RehearsalSettings(**changed)
        return with_chosen_devices(settings, context(tmp_path, "rehearsal"), phantom, target, task or Task())

    return choose, asked


SOFTER = "radifocus_angled_025 in jb2_4f"
WITH_CATHETERS = ("wire alone", "jb2", "simmons2", SOFTER)


def asked_for(*names: str) -> list[str]:
    return [f"devices/{name}/0" for name in names]


def test_what_arrives_is_chosen_and_the_log_says_how_often(chosen: Any, caplog: pytest.LogCaptureFixture) -> None:
    choose, asked = chosen
    never, jb2, simmons = Tried(0, 4, 300.0, 0.2), Tried(3, 4, 150.0, 0.4), Tried(2, 4, 150.0, 0.3)
    outcomes = {"wire alone": never, "jb2": jb2, "simmons2": simmons, SOFTER: Tried(1, 4, 250.0, 0.1)}
    with caplog.at_level(logging.INFO):
        assert choose(outcomes) == (Task(catheter="simmons2"), simmons)
    assert "how it pressed: wire alone 0 of 4 (0.20 N), jb2 3 of 4 (0.40 N), simmons2 2 of 4 (0.30 N)" in caplog.text
    assert asked == [asked_for("wire alone"), asked_for(*WITH_CATHETERS)]

    outcomes[SOFTER] = Tried(3, 4, 200.0, 0.15)
    soft = Task(wire="radifocus_angled_025", catheter="jb2_4f")
    assert choose(outcomes) == (soft, outcomes[SOFTER])
    outcomes["stiff in jb2_4f"] = outcomes[SOFTER]  # a wire that was chosen stays
    assert choose(outcomes, Task(wire="stiff"))[0] == Task(wire="stiff", catheter="jb2_4f")


def test_where_what_arrives_presses_too_hard_the_gentler_ones_get_further_copies(chosen: Any) -> None:
    choose, asked = chosen
    never, jb2 = Tried(0, 4, 300.0, 0.2), Tried(2, 4, 150.0, 0.32)
    outcomes = {"wire alone": never, "jb2": jb2, "simmons2": Tried(1, 4, 300.0, 0.5), SOFTER: Tried(0, 4, 300.0, 0.1)}
    outcomes |= {"wire alone again": Tried(0, 8, 300.0, 0.2), f"{SOFTER} again": Tried(2, 8, 250.0, 0.1)}
    soft = Task(wire="radifocus_angled_025", catheter="jb2_4f")
    assert choose(outcomes) == (soft, outcomes[f"{SOFTER} again"])
    assert asked[1:] == [asked_for(*WITH_CATHETERS), ["devices/wire alone/2", f"devices/{SOFTER}/2"]]

    outcomes[f"{SOFTER} again"] = Tried(0, 8, 300.0, 0.1)
    assert choose(outcomes) == (Task(catheter="jb2"), jb2)  # nothing gentler arrives


def test_where_the_wire_alone_always_arrives_nothing_else_is_tried(chosen: Any) -> None:
    choose, asked = chosen
    always = Tried(4, 4, 100.0, 0.2)
    assert choose({"wire alone": always}) == (Task(), always)
    assert asked == [asked_for("wire alone")]


def test_where_the_wire_alone_arrives_and_presses_softer_ones_are_tried(chosen: Any) -> None:
    choose, asked = chosen
    wires = ("radifocus_angled", "radifocus_angled_025")
    outcomes = {"wire alone": Tried(4, 4, 100.0, 0.8)} | dict(
        zip(wires, (Tried(4, 4, 100.0, 0.5), Tried(3, 4, 120.0, 0.1)), strict=True)
    )
    assert choose(outcomes) == (Task(wire=wires[1]), outcomes[wires[1]])
    assert asked == [asked_for("wire alone"), asked_for("wire alone", *wires)]
    assert choose(outcomes, Task(wire="stiff")) == (Task(wire="stiff"), outcomes["wire alone"])
    assert asked == [asked_for("wire alone")]

    outcomes |= dict.fromkeys(WITH_CATHETERS[1:], Tried(0, 4, 300.0, 0.1)) | {"wire alone": Tried(3, 4, 150.0, 0.8)}
    assert choose(outcomes)[0] == Task(wire=wires[1])
    assert asked[-1] == asked_for(*WITH_CATHETERS, *wires)


def test_where_nothing_arrives_the_shape_decides(chosen: Any) -> None:
    choose, _ = chosen
    never = Tried(0, 4, 300.0, 0.2)
    assert choose(dict.fromkeys(WITH_CATHETERS, never)) == (BY_SHAPE, None)


@pytest.mark.parametrize(
    "changed",
    [
        {"task": Task(catheter="vertebral")},
        {"task": Task(entry="ascending")},
        {"task": Task(pace="arch_variety")},  # one policy alone has it, and critics
        {"fresh": True},
        {"algorithm": "ppo"},
    ],
    ids=["a catheter", "another entry", "another pace", "from nothing", "another algorithm"],
)
def test_without_a_choice_of_policies_nothing_is_tried(chosen: Any, changed: dict[str, Any]) -> None:
    choose, asked = chosen
    assert choose({}, **changed) == (BY_SHAPE, None)
    assert asked == []


def test_a_trial_plays_the_policy_in_copies_that_the_training_has_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    task = Task(max_steps=6)
    named = {start.WIRE_ALONE: task}
    (given,) = start._trials(RehearsalSettings(task=task), context(tmp_path, "rehearsal"), "bca", named).values()
    assert given.copies == tuple(training_copies(0, 2 * start.TRIALS))
    assert given.start is not None
    assert given.start.stem == "generalist"
    played: list[Sequence[int]] = []

    def noted(*arguments: Any, cases: Sequence[int], **further: Any) -> list[Trial]:
        played.append(cases)
        return try_in_copies(*arguments, cases=cases[:1], **further)

    monkeypatch.setattr(start, "try_in_copies", noted)
    trials = [one for part in range(4) for one in try_devices(dataclasses.replace(given, part=part), Report())]
    assert [(reached, len(forces)) for reached, forces in trials] == 4 * [(False, 6)]
    assert [list(cases) for cases in played] == [list(range(k, k + 8, 2)) for k in (0, 1, 8, 9)]


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


def test_a_newton_costs_more_with_two_devices_unless_the_settings_say() -> None:
    task, both = Task(), Task(catheter="jb2")
    assert [RehearsalSettings().price_of_force(one) for one in (task, both)] == [0.1, 0.3]
    assert [RehearsalSettings(force_penalty=0.0).price_of_force(one) for one in (task, both)] == [0.0, 0.0]


@pytest.mark.parametrize(
    ("tried", "price"),
    [(Tried(4, 4, 60.0, 0.5), 1.0), (Tried(4, 4, 60.0, 0.2), 0.1), (Tried(3, 4, 60.0, 0.5), 0.1), (None, 0.1)],
    ids=["presses", "presses little", "does not always arrive", "not tried"],
)
def test_a_newton_costs_more_where_the_wire_alone_always_arrives_and_presses(tried: Tried | None, price: float) -> None:
    settings = RehearsalSettings()
    assert settings.price_of_force(Task(), tried) == price
    assert settings.price_of_force(Task(catheter="jb2"), tried) == 0.3
    assert RehearsalSettings(force_penalty=0.2).price_of_force(Task(), tried) == 0.2
