"""The stage rehearsal: from a scan to a tested policy, from nothing and from a policy, and what it refuses."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cathsim import load_phantom
from enn.policy import Policy
from pipeline.anatomies.devices import fitted_steps, fitted_task
from pipeline.anatomies.settings import check_anatomies
from pipeline.episodes import EpisodeReader
from pipeline.jobs.worker import Report
from pipeline.seeds import ANATOMY_COPIES
from pipeline.stages.rehearsal.copies import RehearsalJob, copies_environment
from pipeline.stages.rehearsal.episodes import film_scan, play
from pipeline.stages.rehearsal.settings import RehearsalSettings
from pipeline.stages.rehearsal.stage import check_rehearsal, plan, row, run_rehearsal
from pipeline.stages.rehearsal.training import train
from pipeline.store.errors import ConfigurationError, StageError
from pipeline.task import Task
from tests.pipeline.stages.rehearsal.small_rehearsal import GENERALIST, TINY, job_of
from tests.pipeline.stages.small_expert import context, in_this_process

FIRST = ANATOMY_COPIES["test"].first


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The policy of a rehearsal."""
    job = job_of(tmp_path_factory.mktemp("trained"))
    train(job, Report())
    return job.own_folder / "policy.pt"


@pytest.mark.parametrize(
    "changed", [{}, {"algorithm": "ppo"}, {"catheter": "vertebral"}], ids=["sac", "ppo", "catheter"]
)
def test_it_trains_in_copies_and_logs_its_tests(tmp_path: Path, changed: dict[str, Any]) -> None:
    job = job_of(tmp_path, **changed)
    cost = train(job, Report())
    assert cost["decisions"] >= 48
    policy = Policy.load(job.own_folder / "policy.pt")
    assert policy.critics
    assert policy.action_space.shape == ((4,) if "catheter" in changed else (2,))
    with np.load(tmp_path / "starts.npz") as starts:
        assert {int(states[0, -1]) for states in starts.values() if len(states)} == {0, 1}
    tested = dataclasses.replace(job, policy=job.own_folder / "policy.pt", tested="after", copies=(FIRST, FIRST + 1))
    outcome = play(tested, Report())
    assert len(outcome["success"]) == 2
    with EpisodeReader(tmp_path / "after/copies" / str(FIRST) / "000.mcap") as log:
        assert log.info.phantom == f"type_1_copy{FIRST}"
        assert log.info.configuration["copy"] == FIRST
        assert len(outcome["forces"][0]) == log.last_step
    before = (tmp_path / "after/copies" / str(FIRST) / "000.mcap").stat().st_mtime_ns
    assert play(tested, Report()) == outcome  # nothing is played again
    assert (tmp_path / "after/copies" / str(FIRST) / "000.mcap").stat().st_mtime_ns == before


def test_it_starts_from_a_policy_and_goes_on_after_an_interruption(
    trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("enn.reinforcement.training.training.TICK", 0.0)  # progress after every decision
    longer = dataclasses.replace(job_of(tmp_path / "second", decisions=80), start=trained)

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
    Policy.load(trained).save(acting)
    with pytest.raises(StageError, match="has no critics"):
        train(dataclasses.replace(job_of(tmp_path / "third"), start=acting), Report())


def test_the_whole_stage_leaves_a_table_and_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("stage", "start"):
        monkeypatch.setattr(f"pipeline.stages.rehearsal.{module}.run_jobs", in_this_process)
    settings = RehearsalSettings(**TINY | {"target": "bca", "workers": 1, "test_copies": 1, "choose_catheter": False})
    run_rehearsal(settings, context(tmp_path, "rehearsal")).write(tmp_path / "rehearsal")
    results = json.loads((tmp_path / "rehearsal/results.json").read_text())
    cells = {f"type_1/{tested} {kind}" for tested in ("before", "after") for kind in ("scan", "copies")}
    assert set(results["rehearsal"]) == cells  # from a shipped policy
    cost = results["rehearsal_cost"]["type_1"]
    assert [cost[key] for key in ("starts_from", "wire", "catheter")] == ["a policy", "default", "none"]
    assert (tmp_path / "rehearsal/after.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("changed", "choose"),
    [({}, True), ({"choose_catheter": False}, False), ({"policy": str(GENERALIST)}, False)],
)
def test_a_catheter_is_chosen_unless_a_policy_is_given(
    changed: dict[str, Any], choose: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def asked(*_: Any, choose: bool = True) -> Task:
        raise ValueError(f"choose is {choose}")

    for name in ("with_catheter_where_steep", "with_chosen_devices"):
        monkeypatch.setattr(f"pipeline.stages.rehearsal.stage.{name}", asked)
    with pytest.raises(ConfigurationError, match=f"choose is {choose}"):
        run_rehearsal(RehearsalSettings(**TINY | changed), context(tmp_path, "rehearsal"))


def test_an_unknown_hyperparameter_is_refused_before_anything_is_played() -> None:
    with pytest.raises(ConfigurationError, match=r"stage.training has no 'foo': choose from .*learning_rate"):
        check_rehearsal(RehearsalSettings(**TINY | {"training": {"foo": 3}}))


def test_copies_of_training_validation_and_tests_never_meet(tmp_path: Path) -> None:
    settings = RehearsalSettings(**TINY | {"copies": 16, "validation_copies": 23, "test_copies": 30})
    jobs = {job.key: job for job in plan(settings, context(tmp_path, "rehearsal"), settings.task, "bca", Path("p.pt"))}
    tested = [copy for key in jobs if "copies" in key for copy in jobs[key].given.copies]
    assert len(tested) == 60  # before and after
    assert set(tested) <= set(ANATOMY_COPIES["test"].all)
    assert {jobs[key].after for key in jobs if key.startswith("before")} == {()}
    assert {jobs[key].after for key in jobs if key.startswith("after")} == {("training",)}


def test_a_training_is_priced_and_the_tests_are_not(tmp_path: Path) -> None:
    job = job_of(tmp_path, force_penalty=0.7, force_threshold_n=0.1, walls_mm=0.5, breathing_mm=0.0)
    training, tests = copies_environment(job, (0, 1), training=True), copies_environment(job, (0, 1))
    assert (training.current.task.force_penalty, tests.current.task.force_penalty) == (0.7, 0.0)
    assert training.current.task.force_threshold == 0.1
    assert training.simulation.numerics.timestep == 2 * tests.simulation.numerics.timestep
    assert training.perturbation.walls == 0.5e-3
    assert training.perturbation.friction == 0.3


def test_the_price_of_a_plan_is_that_of_its_training(tmp_path: Path) -> None:
    settings = RehearsalSettings(**TINY)
    jobs = plan(settings, context(tmp_path, "rehearsal"), settings.task, "bca", None, force_price=0.7)
    (training,) = [job.given for job in jobs if job.key == "training"]
    environment = copies_environment(training, (0,), training=True)
    assert environment.current.task.force_penalty == 0.7
    environment.close()


def test_the_wire_becomes_as_long_as_the_way_asks_for() -> None:
    phantom = load_phantom("type_1")
    assert fitted_task(Task(), phantom, ["lsa_end"]) == Task()  # the preset's reaches it
    far = max(phantom.targets, key=phantom.way_length)
    assert fitted_task(Task(), phantom, [far]).guidewire().length > phantom.way_length(far) + 0.05
    assert fitted_task(Task(wire_length_mm=280.0), phantom, ["lsa_end"]).wire_length_mm == 280.0


def test_a_long_way_gets_longer_episodes_and_the_log_says_so(caplog: pytest.LogCaptureFixture) -> None:
    phantom = load_phantom("type_1")
    assert fitted_steps(Task(), phantom, "lcca") == Task()  # 202 mm
    assert not caplog.messages
    assert fitted_steps(Task(max_steps=150), phantom, "lcca").max_steps == 400
    assert "the way to lcca of type_1 is 202 mm long, for which 150 steps are few: episodes last 400" in caplog.text
    faster = Task(max_steps=150, pace="arch_variety")
    assert fitted_steps(faster, phantom, "lcca") == faster


def test_the_anatomy_is_a_file_a_name_or_a_seed() -> None:
    assert RehearsalSettings().phantoms == ["type_1"]
    assert RehearsalSettings(phantom="bovine").phantoms == ["bovine"]
    assert RehearsalSettings(phantom="random", phantom_seed=3).phantoms == ["random_3"]
    with pytest.raises(ConfigurationError, match="needs a seed"):
        check_anatomies(RehearsalSettings(phantom="random"))
    with pytest.raises(ConfigurationError, match="names several"):
        RehearsalSettings(targets=["bca", "lcca"])


def test_an_episode_of_the_tests_has_so_many_attempts(trained: Path, tmp_path: Path) -> None:
    alone, again = (job_of(tmp_path / str(attempts), attempts=attempts) for attempts in (1, 2))
    steps = alone.task.max_steps

    def outcome(job: RehearsalJob) -> dict[str, Any]:
        return play(dataclasses.replace(job, policy=trained, tested="after", copies=(FIRST, FIRST + 1)), Report())

    once, twice = outcome(alone), outcome(again)
    assert twice["success"] == once["success"]
    for first, forces, more in zip(once["success"], once["forces"], twice["forces"], strict=True):
        assert more[: len(forces)] == forces  # the first attempt is the episode without a second
        assert first or len(more) > steps + 1


def test_the_film_repeats_the_first_episode_in_the_scan_that_arrived(trained: Path, tmp_path: Path) -> None:
    from PIL import Image

    tested = dataclasses.replace(job_of(tmp_path, scan_episodes=3), policy=trained, tested="after", copies=(0,))
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
    assert cells["success_pct"] == 50.0
    assert cells["within_attempts_pct"] == 100.0
    assert cells["depth_mm"] == pytest.approx(20.0)
    assert cells["force_n"] == 1.0
    assert cells["force_max_n"] == 2.0
    assert cells["episode_length_steps"] == 1.5
    assert cells["n"] == 2


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"file": "missing.stl"}, "phantom.file=missing.stl is no file"),
        ({"policy": "missing.pt"}, "stage.policy=missing.pt is no file"),
        ({"unit": "mm"}, "phantom.unit belongs to a file"),
        ({"target": "bca", "point_mm": [0.0, 0.0, 0.0]}, "stage.point_mm is the target"),
        ({"policy": __file__, "fresh": True}, "stage.fresh=true starts from nothing"),
        ({"file": __file__, "phantom": "type_1"}, "phantom.file brings the anatomy"),
        ({"walls_mm": 50.0}, "stage.walls_mm must be 20"),
        ({"share_of_decisions": 0.01}, "stage.share_of_decisions must be 0.1"),
    ],
)
def test_bad_settings_are_one_sentence(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        RehearsalSettings(**values)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"target": "aorta"}, "unknown target 'aorta'"),
        ({"point_mm": [500.0, 0.0, 0.0]}, "outside|inside"),
        ({"phantom": "type_9"}, "unknown phantom 'type_9'"),
        ({"file": __file__}, "convert it"),
    ],
)
def test_an_anatomy_or_target_that_is_not_there(tmp_path: Path, values: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        run_rehearsal(RehearsalSettings(**TINY | values), context(tmp_path, "rehearsal"))
