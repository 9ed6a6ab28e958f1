"""The stage rehearsal: devices and policy that it starts from, from a scan to a tested policy, what it refuses."""

import json
import logging
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from cathsim import load_phantom
from enn.device_trials import Trial, TrialStatistics, try_in_copies
from enn.policy import Policy
from enn.shipped import weight_files
from pipeline.anatomies.devices import fitted_steps, fitted_task
from pipeline.episodes import EpisodeReader
from pipeline.jobs.worker import Report
from pipeline.seeds import ANATOMY_COPIES, training_copies
from pipeline.stages.rehearsal import stage, start
from pipeline.stages.rehearsal.copies import RehearsalJob, copies_environment
from pipeline.stages.rehearsal.episodes import film_scan, play
from pipeline.stages.rehearsal.settings import RehearsalSettings
from pipeline.stages.rehearsal.stage import check_rehearsal, plan, row, run_rehearsal
from pipeline.stages.rehearsal.training import train
from pipeline.store.errors import ConfigurationError, StageError
from pipeline.task import Task
from tests.pipeline.stages.rehearsal.small_rehearsal import GENERALIST, TINY, job_of
from tests.pipeline.stages.small_expert import context, run_here

FIRST = ANATOMY_COPIES["test"].first


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> RehearsalJob:
    """A rehearsal whose policy is trained."""
    job = job_of(tmp_path_factory.mktemp("trained"))
    train(job, Report())
    return job


@pytest.mark.parametrize(
    "changed",
    [{}, {"algorithm": "ppo"}, {"task": replace(TINY["task"], catheter="vertebral")}],
    ids=["sac", "ppo", "catheter"],
)
def test_it_trains_in_copies_and_logs_its_tests(trained: RehearsalJob, tmp_path: Path, changed: dict[str, Any]) -> None:
    job = job_of(tmp_path, **changed) if changed else trained
    assert not changed or train(job, Report())["decisions"] >= 48
    policy = Policy.load(job.own_folder / "policy.pt")
    assert policy.critics
    assert policy.action_space.shape == ((4,) if "task" in changed else (2,))
    with np.load(job.folder / "starts.npz") as starts:
        assert {int(states[0, -1]) for states in starts.values() if len(states)} == {0, 1}
    tested = trial_of(job, replace(job, folder=tmp_path), FIRST, FIRST + 1)
    outcome = play(tested, Report())
    assert len(outcome["success"]) == 2
    file = tmp_path / "after/copies" / str(FIRST) / "000.mcap"
    with EpisodeReader(file) as log:
        assert log.info.phantom == f"type_1_copy{FIRST}"
        assert log.info.configuration["copy"] == FIRST
        assert len(outcome["forces"][0]) == log.last_step
    before = file.stat().st_mtime_ns
    assert play(tested, Report()) == outcome  # nothing is played again
    assert file.stat().st_mtime_ns == before


def trial_of(trained: RehearsalJob, job: RehearsalJob, *copies: int) -> RehearsalJob:
    """Tests of a rehearsal's policy, as another job has them."""
    return replace(job, policy=trained.own_folder / "policy.pt", tested="after", copies=copies)


def test_it_starts_from_a_policy_and_goes_on_after_an_interruption(
    trained: RehearsalJob, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("enn.reinforcement.training.training.TICK", 0.0)  # progress after every decision
    start = trained.own_folder / "policy.pt"
    longer = replace(job_of(tmp_path / "second", decisions=80), start=start)

    class Stopping(Report):
        def __call__(self, fraction: float, text: str = "") -> None:
            if fraction > 0.5:
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(longer, Stopping())
    assert (longer.own_folder / "checkpoint/index.json").is_file()
    train(longer, Report())
    record = json.loads((longer.own_folder / "training.json").read_text())
    assert record["settings"]["hidden"] == [16, 16]
    acting = tmp_path / "acting.pt"
    Policy.load(start).save(acting)
    with pytest.raises(StageError, match="has no critics"):
        train(replace(job_of(tmp_path / "third"), start=acting), Report())


def test_the_whole_stage_leaves_a_table_and_pictures(tmp_path: Path) -> None:
    settings = RehearsalSettings(**TINY | {"target": "bca", "workers": 1, "test_copies": 1, "choose_catheter": False})
    results = run_here(settings, tmp_path, stage)
    cells = {f"type_1/{tested} {kind}" for tested in ("before", "after") for kind in ("scan", "copies")}
    assert set(results["rehearsal"]) == cells  # from a shipped policy
    cost = results["rehearsal_cost"]["type_1"]
    assert [cost[key] for key in ("starts_from", "wire", "catheter")] == ["a policy", "default", "none"]
    assert (tmp_path / "rehearsal/after.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("changed", "choose"), [({}, True), ({"choose_catheter": False}, False), ({"policy": str(GENERALIST)}, False)]
)
def test_a_catheter_is_chosen_unless_a_policy_is_given(
    changed: dict[str, Any], choose: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def choice(*_: Any, choose: bool = True) -> Task:
        raise ValueError(f"choose is {choose}")

    for name in ("with_catheter_where_steep", "with_chosen_devices"):
        monkeypatch.setattr(f"pipeline.stages.rehearsal.stage.{name}", choice)
    with pytest.raises(ConfigurationError, match=f"choose is {choose}"):
        run_rehearsal(RehearsalSettings(**TINY | changed), context(tmp_path, "rehearsal"))


def test_copies_of_training_validation_and_tests_never_meet(tmp_path: Path) -> None:
    settings = RehearsalSettings(**TINY | {"copies": 16, "validation_copies": 23, "test_copies": 30})
    jobs = {job.key: job for job in plan(settings, context(tmp_path, "rehearsal"), settings.task, "bca", Path("p.pt"))}
    tested = [copy for key in jobs if "copies" in key for copy in jobs[key].given.copies]
    assert len(tested) == 60  # before and after
    assert set(tested) <= set(ANATOMY_COPIES["test"].all)
    assert {jobs[key].after for key in jobs if key.startswith("before")} == {()}
    assert {jobs[key].after for key in jobs if key.startswith("after")} == {("training",)}


def test_a_training_is_priced_and_the_tests_are_not(tmp_path: Path) -> None:
    priced = {"force_penalty": 0.7, "force_threshold_n": 0.1, "walls_mm": 0.5, "breathing_mm": 0.0}
    settings = RehearsalSettings(**TINY | priced)
    jobs = plan(settings, context(tmp_path, "rehearsal"), settings.task, "bca", None)
    (job,) = [job.given for job in jobs if job.key == "training"]
    training, tests = copies_environment(job, (0, 1), training=True), copies_environment(job, (0, 1))
    assert (training.current.task.force_penalty, tests.current.task.force_penalty) == (0.7, 0.0)
    assert training.current.task.force_threshold == 0.1
    assert training.simulation.numerics.timestep == 2 * tests.simulation.numerics.timestep
    assert (training.perturbation.walls, training.perturbation.friction) == (0.5e-3, 0.3)


def test_a_long_way_gets_a_longer_wire_and_longer_episodes(caplog: pytest.LogCaptureFixture) -> None:
    phantom = load_phantom("type_1")
    assert fitted_task(Task(), phantom, ["lsa_end"]) == Task()  # the preset's reaches it
    far = max(phantom.targets, key=phantom.way_length)
    assert fitted_task(Task(), phantom, [far]).guidewire().length > phantom.way_length(far) + 0.05
    assert fitted_task(Task(wire_length_mm=280.0), phantom, ["lsa_end"]).wire_length_mm == 280.0
    assert fitted_steps(Task(), phantom, "lcca") == Task()  # 202 mm
    assert not caplog.messages
    assert fitted_steps(Task(max_steps=150), phantom, "lcca").max_steps == 400
    assert "for which 150 steps are few: episodes last 400" in caplog.text
    faster = Task(max_steps=150, pace="arch_variety")
    assert fitted_steps(faster, phantom, "lcca") == faster


def test_several_targets_and_an_unknown_hyperparameter_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="names several"):
        RehearsalSettings(targets=["bca", "lcca"])
    with pytest.raises(ConfigurationError, match=r"stage\.training has no 'foo'"):
        check_rehearsal(RehearsalSettings(**TINY | {"training": {"foo": 3}}))


def test_an_episode_of_the_tests_has_so_many_attempts(trained: RehearsalJob, tmp_path: Path) -> None:
    jobs = [job_of(tmp_path / str(attempts), attempts=attempts) for attempts in (1, 2)]
    once, twice = (play(trial_of(trained, job, FIRST, FIRST + 1), Report()) for job in jobs)
    assert twice["success"] == once["success"]
    for first, forces, more in zip(once["success"], once["forces"], twice["forces"], strict=True):
        assert more[: len(forces)] == forces  # the first attempt is the episode without a second
        assert first or len(more) > jobs[0].task.max_steps + 1


def test_the_film_repeats_the_first_episode_in_the_scan_that_arrived(trained: RehearsalJob, tmp_path: Path) -> None:
    tested = trial_of(trained, job_of(tmp_path, scan_episodes=3), 0)
    arrived = play(tested, Report())["success"]
    outcome = film_scan(tested, Report())
    assert outcome["episode"] == (arrived.index(True) if any(arrived) else 0)
    assert outcome["arrived"] == any(arrived)
    with EpisodeReader(tmp_path / f"after/scan/0/{outcome['episode']:03d}.mcap") as log:
        assert outcome["steps"] == log.last_step
    with Image.open(tmp_path / "after.gif") as film:
        assert film.n_frames >= outcome["steps"] // 2


def test_a_row_pools_the_forces_of_all_steps() -> None:
    parts = {
        "after/copies0": {"success": [True], "within_attempts": [True], "depths": [0.03], "forces": [[0.0, 1.0]]},
        "after/copies1": {"success": [False], "within_attempts": [True], "depths": [0.01], "forces": [[2.0]]},
    }
    scan = {"after/scan": {"success": [True], "within_attempts": [True], "depths": [0.09], "forces": [[9.0]]}}
    cells = row(parts | scan, "after", "copies")
    expected = {"success_pct": 50.0, "within_attempts_pct": 100.0, "depth_mm": 20.0, "force_n": 1.0}
    expected |= {"force_max_n": 2.0, "episode_length_steps": 1.5, "n": 2}
    assert {name: cells[name] for name in expected} == pytest.approx(expected)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"policy": "missing.pt"}, "stage.policy=missing.pt is no file"),
        ({"policy": __file__, "fresh": True}, "stage.fresh=true starts from nothing"),
        ({"target": "aorta"}, "unknown target 'aorta'"),
        ({"point_mm": [500.0, 0.0, 0.0]}, "outside|inside"),
        ({"phantom": "type_9"}, "unknown phantom 'type_9'"),
        ({"file": __file__}, "convert it"),
    ],
)
def test_what_is_not_there_is_refused_by_name(tmp_path: Path, values: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        run_rehearsal(RehearsalSettings(**TINY | values), context(tmp_path, "rehearsal"))


BY_SHAPE = Task(catheter="pigtail")  # what nothing else gives


@pytest.fixture
def chosen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Chooses with trials that end as said; also which played, call by call."""
    calls: list[list[str]] = []
    phantom = load_phantom("type_1")

    def choose(
        outcomes: dict[str, Any], task: Task | None = None, **changed: Any
    ) -> tuple[Task, TrialStatistics | None]:
        calls.clear()

        def run(folder: Any, jobs: Any, **_: Any) -> dict[str, Any]:
            assert [job.given.part % 2 for job in jobs] == [0, 1] * (len(jobs) // 2)
            calls.append([job.key for job in jobs[::2]])
            return {job.key: [job.key.split("/")[1]] for job in jobs}

        def of(trials: list[str]) -> TrialStatistics:  # what the trials come to
            assert set(trials) == {trials[0]}
            return outcomes[trials[0] + " again" * (len(trials) > 2)]

        monkeypatch.setattr(start, "run_jobs", run)
        monkeypatch.setattr(TrialStatistics, "of", of)
        monkeypatch.setattr(start, "with_catheter_where_steep", lambda *_, choose: BY_SHAPE)
        settings = RehearsalSettings(**changed)
        return start.with_chosen_devices(settings, context(tmp_path, "rehearsal"), phantom, "lcca", task or Task())

    return choose, calls


SOFTER = "radifocus_angled_025 in jb2_4f"
WITH_CATHETERS = ("wire alone", "jb2", "simmons2", SOFTER)


def asked_for(*names: str) -> list[str]:
    return [f"devices/{name}/0" for name in names]


def test_what_arrives_is_chosen_and_the_log_says_how_often(chosen: Any, caplog: pytest.LogCaptureFixture) -> None:
    choose, calls = chosen
    never = TrialStatistics(0, 4, 300.0, 0.2)
    jb2 = TrialStatistics(3, 4, 150.0, 0.4)
    simmons = TrialStatistics(2, 4, 150.0, 0.3)
    outcomes = {"wire alone": never, "jb2": jb2, "simmons2": simmons, SOFTER: TrialStatistics(1, 4, 250.0, 0.1)}
    with caplog.at_level(logging.INFO):
        assert choose(outcomes) == (Task(catheter="simmons2"), simmons)
    assert "how it pressed: wire alone 0 of 4 (0.20 N), jb2 3 of 4 (0.40 N), simmons2 2 of 4 (0.30 N)" in caplog.text
    assert calls == [asked_for("wire alone"), asked_for(*WITH_CATHETERS[1:])]

    outcomes[SOFTER] = TrialStatistics(3, 4, 200.0, 0.15)
    soft = Task(wire="radifocus_angled_025", catheter="jb2_4f")
    assert choose(outcomes) == (soft, outcomes[SOFTER])
    outcomes["stiff in jb2_4f"] = outcomes[SOFTER]  # a wire that was chosen stays
    assert choose(outcomes, Task(wire="stiff"))[0] == Task(wire="stiff", catheter="jb2_4f")


def test_where_what_arrives_presses_too_hard_the_gentler_ones_get_further_copies(chosen: Any) -> None:
    choose, calls = chosen
    never, jb2 = TrialStatistics(0, 4, 300.0, 0.2), TrialStatistics(2, 4, 150.0, 0.32)
    outcomes = {"wire alone": never, "jb2": jb2, "simmons2": TrialStatistics(1, 4, 300.0, 0.5)}
    outcomes[SOFTER] = TrialStatistics(1, 4, 300.0, 0.1)
    outcomes[f"{SOFTER} again"] = TrialStatistics(4, 8, 250.0, 0.1)
    soft = Task(wire="radifocus_angled_025", catheter="jb2_4f")
    assert choose(outcomes) == (soft, outcomes[f"{SOFTER} again"])
    assert calls[1:] == [asked_for(*WITH_CATHETERS[1:]), [f"devices/{SOFTER}/2"]]  # the wire never arrives

    outcomes[f"{SOFTER} again"] = TrialStatistics(3, 8, 300.0, 0.1)
    assert choose(outcomes) == (Task(catheter="jb2"), jb2)  # nothing gentler arrives often enough to learn from


def test_the_wire_alone_is_enough_where_it_always_arrives_and_the_shape_decides_where_none_does(chosen: Any) -> None:
    choose, calls = chosen
    always, never = TrialStatistics(4, 4, 100.0, 0.2), TrialStatistics(0, 4, 300.0, 0.2)
    assert choose({"wire alone": always}) == (Task(), always)
    assert calls == [asked_for("wire alone")]
    assert choose(dict.fromkeys(WITH_CATHETERS, never)) == (BY_SHAPE, None)


def test_where_the_wire_alone_arrives_and_presses_catheters_and_softer_ones_are_tried(chosen: Any) -> None:
    choose, calls = chosen
    wires = ("radifocus_angled", "radifocus_angled_025")
    outcomes = {"wire alone": TrialStatistics(4, 4, 100.0, 0.8)}
    outcomes |= dict.fromkeys(WITH_CATHETERS[1:], TrialStatistics(0, 4, 300.0, 0.1))
    stiff = outcomes | {"stiff in jb2_4f": outcomes[SOFTER]}
    assert choose(stiff, Task(wire="stiff")) == (Task(wire="stiff"), outcomes["wire alone"])
    assert calls == [asked_for("wire alone"), asked_for("jb2", "simmons2", "stiff in jb2_4f")]

    outcomes |= {wires[0]: TrialStatistics(4, 4, 100.0, 0.5), wires[1]: TrialStatistics(3, 4, 120.0, 0.1)}
    assert choose(outcomes) == (Task(wire=wires[1]), outcomes[wires[1]])
    assert calls == [asked_for("wire alone"), asked_for(*WITH_CATHETERS[1:], *wires)]
    outcomes["wire alone"] = TrialStatistics(3, 4, 150.0, 0.8)
    assert choose(outcomes)[0] == Task(wire=wires[1])

    # a wire that seldom arrives is not taken for being soft
    outcomes |= {wires[0]: TrialStatistics(1, 4, 200.0, 0.29), wires[1]: TrialStatistics(0, 4, 300.0, 0.1)}
    outcomes |= {f"{wires[0]} again": TrialStatistics(1, 8, 200.0, 0.29), SOFTER: TrialStatistics(3, 4, 150.0, 0.44)}
    assert choose(outcomes) == (Task(wire="radifocus_angled_025", catheter="jb2_4f"), outcomes[SOFTER])


def test_without_a_choice_of_policies_nothing_is_tried(chosen: Any) -> None:
    choose, calls = chosen
    others = (Task(catheter="vertebral"), Task(entry="ascending"), Task(pace="arch_variety"))  # or no critics
    for changed in ({"fresh": True}, {"algorithm": "ppo"}, *({"task": task} for task in others)):
        assert choose({}, **changed) == (BY_SHAPE, None)
        assert calls == []


def test_a_trial_plays_the_policy_in_copies_of_the_training(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    task = Task(max_steps=6)
    named = {start.WIRE_ALONE: task}
    (given,) = start._trials(RehearsalSettings(task=task), context(tmp_path, "rehearsal"), "bca", named).values()
    assert given.copies == tuple(training_copies(0, 2 * start.TRIALS))
    assert given.start == GENERALIST
    played: list[Sequence[int]] = []

    def noted(*arguments: Any, cases: Sequence[int], **further: Any) -> list[Trial]:
        played.append(cases)
        return try_in_copies(*arguments, cases=cases[:1], **further)

    monkeypatch.setattr(start, "try_in_copies", noted)
    trials = [one for part in range(4) for one in start.try_devices(replace(given, part=part), Report())]
    assert [(reached, len(forces)) for reached, forces in trials] == 4 * [(False, 6)]
    assert [list(cases) for cases in played] == [list(range(k, k + 8, 2)) for k in (0, 1, 8, 9)]


OF_SIMMONS = next(file for file in weight_files() if file.stem == "generalist_simmons2")


def test_the_policy_of_the_run_comes_before_a_shipped_one(tmp_path: Path) -> None:
    alone, shipped = Task(), GENERALIST
    assert start.starting_policy(RehearsalSettings(), tmp_path, 0, alone) == shipped
    file = tmp_path / "unseen/roadmap/seed0/policy.pt"
    file.parent.mkdir(parents=True)
    shutil.copy(shipped, file)
    assert start.starting_policy(RehearsalSettings(), tmp_path, 0, alone) == file
    hashes = start.policy_hashes(tmp_path)
    assert hashes["unseen/roadmap/seed0/policy.pt"] == hashes[f"shipped/{shipped.name}"]
    assert start.policy_hashes(tmp_path / "elsewhere") == {k: v for k, v in hashes.items() if k.startswith("shipped/")}
    assert start.starting_policy(RehearsalSettings(fresh=True), tmp_path, 0, alone) is None
    assert start.starting_policy(RehearsalSettings(policy=str(shipped)), tmp_path, 0, alone) == shipped
    file.write_bytes(b"x")
    with pytest.raises(ValueError, match=r"policy\.pt"):
        start.starting_policy(RehearsalSettings(), tmp_path, 0, alone)


def test_a_policy_of_other_actions_is_not_started_from_but_one_of_another_catheter(tmp_path: Path) -> None:
    assert start.starting_policy(RehearsalSettings(), tmp_path, 0, Task(pace="arch_variety")) is None  # without critics
    for task in (Task(catheter="jb2", wire="none"), Task(actions="tip_motors")):
        assert start.starting_policy(RehearsalSettings(), tmp_path, 0, task) is None
        assert start.advising_policies(tmp_path, 0, task, None) == []
    assert start.starting_policy(RehearsalSettings(algorithm="ppo"), tmp_path, 0, Task()) is None
    asked = {}
    for catheter in ("simmons2", "simmons2_4f", "vertebral"):
        task = Task(catheter=catheter)
        begun = start.starting_policy(RehearsalSettings(), tmp_path, 0, task)
        asked[catheter] = [path.stem for path in start.advising_policies(tmp_path, 0, task, begun)]
    assert asked["simmons2"] == ["generalist_simmons2", "navigator_simmons2"]  # a catheter's own policies are enough
    assert asked["simmons2_4f"] == asked["simmons2"]  # of the same shape in another size
    assert asked["vertebral"] == ["generalist_jb2", "generalist_simmons2"]


def test_a_given_policy_brings_its_catheter_or_steers_a_wire_alone(tmp_path: Path) -> None:
    assert start.with_devices_of(GENERALIST, Task()) == Task()
    assert start.with_devices_of(OF_SIMMONS, Task(max_steps=7)) == Task(catheter="simmons2", max_steps=7)
    assert start.with_devices_of(OF_SIMMONS, Task(catheter="jb2")) == Task(catheter="jb2")
    settings = RehearsalSettings(**TINY | {"policy": str(GENERALIST), "task": Task(catheter="jb2")})
    with pytest.raises(ConfigurationError, match="steers a wire alone"):
        run_rehearsal(settings, context(tmp_path, "rehearsal"))


def test_a_newton_costs_more_with_two_devices_and_where_the_wire_presses() -> None:
    alone, both, presses = Task(), Task(catheter="jb2"), TrialStatistics(4, 4, 60.0, 0.5)
    assert RehearsalSettings().price_of_force(alone, presses) == 1.0
    for tried in (
        TrialStatistics(4, 4, 60.0, 0.2),
        TrialStatistics(3, 4, 60.0, 0.5),
        None,
    ):  # little, not always, never
        assert RehearsalSettings().price_of_force(alone, tried) == 0.1
    for tried in (presses, None):
        assert RehearsalSettings().price_of_force(both, tried) == 0.3
        for given in (0.0, 0.2):
            assert RehearsalSettings(force_penalty=given).price_of_force(alone, tried) == given
            assert RehearsalSettings(force_penalty=given).price_of_force(both) == given


def test_policies_of_devices_that_are_no_presets_take_no_part() -> None:
    left_out = {file.stem for file in weight_files()} - {file.stem for file in start.shipped_policies()}
    assert left_out == {"random_trees"}
