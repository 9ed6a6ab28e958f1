"""The unseen stage: its plan, and its jobs at the smallest size, also after an interruption."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import ConfigurationError
from pipeline.job_worker import Report
from pipeline.learning_settings import UnseenSettings
from pipeline.report.learning_tables import tables_from_logs
from pipeline.seeds import unseen_arches, validation_arches
from pipeline.stages.unseen import (
    check_unseen,
    curve,
    plan,
    training_settings,
)
from pipeline.task import Task
from pipeline.trials import Origin
from pipeline.unseen_jobs import (
    AnatomiesJob,
    HeldOutSet,
    RoadmapJob,
    StudentJob,
    build_anatomies,
    train_roadmap,
    train_student,
)
from pipeline.unseen_starts import StartsJob, lay_starts, read_starts
from pipeline.unseen_task import UnseenTask, training_arch

TASK = UnseenTask(("lcca",), Task(wire_length_mm=312.0, image_size_px=96, max_steps=16))
TESTS = (HeldOutSet("unseen", (1,)),)


@pytest.fixture(autouse=True)
def own_cache(anatomy_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CATHSIM_CACHE", str(anatomy_cache))


def settings(**changed) -> UnseenSettings:
    values = {"curve": [1, 4], "anatomies": 8, "image_anatomies": 20, "phantoms": ["type_1"], "wires": ["softer"]}
    return UnseenSettings(**{**values, **changed})


def test_plan_never_trains_on_what_it_tests(tmp_path: Path) -> None:
    jobs = {job.key: job for job in plan(settings(), tmp_path, run_seed=3)}
    policies = ["roadmap", "image", "roadmap 1", "roadmap 4"]
    assert [key for key in jobs if "/" not in key] == ["roadmap", "image", "roadmap tests", "roadmap 1", "roadmap 4"]
    assert jobs["roadmap tests"].given == replace(jobs["roadmap"].given, tests=jobs["roadmap tests"].given.tests)
    for key in (*policies, "roadmap tests"):
        given = jobs[key].given
        assert given.anatomies == tuple(range(3000, 3000 + len(given.anatomies)))
        tested = {phantom for test in given.tests for phantom in test.phantoms}
        assert not tested & set(given.anatomies)
    assert [len(jobs[key].given.anatomies) for key in policies] == [8, 20, 1, 4]
    assert [test.name for test in jobs["image"].given.tests] == ["unseen", "type_1", "unseen softer"]
    assert [test.name for test in jobs["roadmap 4"].given.tests] == ["unseen"]
    assert jobs["image"].after == ("roadmap",)
    built = [arch for job in jobs.values() if isinstance(job.given, AnatomiesJob) for arch in job.given.arches]
    tested = [("random", seed) for seed in unseen_arches(50)]
    validated = [("random", seed) for seed in validation_arches(16)]
    trained = [(("random", "random_wide")[seed % 2], seed) for seed in range(3000, 3020)]
    assert built == [*trained, *validated, *tested]
    assert jobs["roadmap"].given.validated == tuple(seed for _, seed in validated)
    assert "image" not in {job.key for job in plan(settings(image=False), tmp_path, run_seed=3)}


def test_plan_demonstrates_in_training_anatomies(tmp_path: Path) -> None:
    jobs = {job.key: job for job in plan(settings(demonstrations=5), tmp_path, run_seed=1)}
    shown = [jobs["demonstrations/0"].given, jobs["demonstrations/1"].given]
    assert sorted(seed for given in shown for seed in given.shown) == list(range(1000, 1005))
    assert {"demonstrations/0", "demonstrations/1"} <= set(jobs["roadmap 4"].after)
    assert jobs["roadmap 4"].given.settings.bank_cases == 8
    none = plan(settings(demonstrations=0), tmp_path, run_seed=1)
    assert not [job.key for job in none if job.key.startswith("demonstrations")]
    assert jobs["roadmap"].given.demonstrations == tmp_path / "demonstrations"


def test_plan_lays_starts_in_every_training_anatomy(tmp_path: Path) -> None:
    jobs = {job.key: job for job in plan(settings(anatomies=20), tmp_path, run_seed=1)}
    laid = [job for job in jobs.values() if isinstance(job.given, StartsJob)]
    assert [seed for job in laid for seed in job.given.anatomies] == list(range(1000, 1020))
    assert {job.key for job in laid} <= set(jobs["roadmap 1"].after)
    assert [job.after for job in laid] == [("training/1000",), ("training/1016",)]
    assert jobs["roadmap"].given.starts == tmp_path / "starts"
    sizes = {key: jobs[key].given.settings.decisions for key in ("roadmap", "roadmap 1", "roadmap 4")}
    assert sizes == {"roadmap": 16_000, "roadmap 1": 8_000, "roadmap 4": 8_000}


def test_laid_starts_lie_before_the_target_and_are_laid_once(tmp_path: Path) -> None:
    job = StartsJob(tmp_path / "starts", TASK, (4,), seed=0)
    told = lay_starts(job, Report())
    assert told["anatomies"] == 1
    assert told["states"] >= 8
    written = (job.folder / "4.npz").stat().st_mtime_ns
    assert lay_starts(job, Report()) == told
    assert (job.folder / "4.npz").stat().st_mtime_ns == written

    (starts,) = read_starts(job.folder, (4,), TASK.targets)
    assert len(starts) == told["states"]
    assert (starts[:, -1] == 0).all()
    environment = TASK.training_environment((4,), ("tip",))
    begun = environment.start_state()
    remaining = []
    for start in starts:
        environment.reset(options={"start": start})
        remaining.append(environment.task.remaining(environment.phantom, environment.simulation.tip))
    environment.reset(seed=0)
    whole = environment.task.remaining(environment.phantom, environment.simulation.tip)
    assert starts.shape[1] == len(begun)
    assert TASK.task.success_radius < min(remaining) < 0.03
    assert max(remaining) < 0.7 * whole


def test_wires_of_the_tests() -> None:
    task = UnseenTask(("bca",), Task(wire_length_mm=312.0))
    default, softer, stiffer, thesis = (task.wire(kind) for kind in ("default", "softer", "stiffer", "thesis"))
    assert default.links == softer.links
    assert stiffer.tip_stiffness_nmm2 == pytest.approx(4 * softer.tip_stiffness_nmm2)
    assert stiffer.shaft_stiffness_nmm2 == pytest.approx(2 * default.shaft_stiffness_nmm2)
    assert {round(1e3 * wire.length) for wire in (default, softer, stiffer, thesis)} == {312}


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"targets": ["aorta"]}, "unknown target 'aorta': choose from bca, lcca, lsa"),
        ({"phantoms": ["type_9"]}, "unknown phantom 'type_9': choose from type_1"),
        ({"wires": ["rope"]}, "unknown wire 'rope': choose from default"),
    ],
)
def test_unknown_names_are_one_sentence(changed: dict, sentence: str) -> None:
    with pytest.raises(ConfigurationError, match=sentence):
        check_unseen(settings(**changed))


def test_impossible_sizes_are_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"stage\.lessons must be 1 or more, got 0"):
        settings(lessons=0)
    with pytest.raises(ConfigurationError, match="seed 20 has no training arches of its own, only seeds 0 to 19"):
        plan(settings(), tmp_path, run_seed=20)
    with pytest.raises(ConfigurationError, match="a seed has 1000 training arches of its own, got 1001: choose fewer"):
        plan(settings(anatomies=1001), tmp_path, run_seed=0)


def test_a_missing_mesh_is_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    jobs = plan(settings(curve=[], mesh=str(tmp_path / "aorta.stl")), tmp_path, run_seed=0)
    assert "the test on a scanned anatomy is left out" in caplog.text
    assert "real_mesh" not in [test.name for test in jobs[-1].given.tests]
    (tmp_path / "aorta.stl").touch()
    jobs = plan(settings(curve=[], mesh=str(tmp_path / "aorta.stl")), tmp_path, run_seed=0)
    assert "real_mesh" in [test.name for test in jobs[-1].given.tests]


def student_job(folder: Path, rounds: int) -> StudentJob:
    return StudentJob(
        folder=folder / "unseen" / "image" / "seed0",
        expert=folder / "unseen" / "roadmap" / "seed0" / "policy.pt",
        task=TASK,
        anatomies=(0,),
        segmenter_epochs=1,
        rounds=rounds,
        lessons=2,
        epochs=1,
        seed=0,
        origin=Origin("unseen", "image", 0, "desk"),
        tests=TESTS,
    )


def test_jobs_leave_policies_logs_and_tables(tmp_path: Path) -> None:
    assert build_anatomies(AnatomiesJob((training_arch(0),), ("lcca",)), Report()) == {"anatomies": 1}
    assert lay_starts(StartsJob(tmp_path / "starts", TASK, (0,), seed=0), Report())["states"] > 0
    tiny = replace(
        training_settings(settings(targets=["lcca"], anatomies=1, decisions=160, validation_episodes=1, hidden=16), 1),
        learning_starts=32,
        n_envs=4,
    )
    teacher = RoadmapJob(
        folder=tmp_path / "unseen" / "roadmap" / "seed0",
        task=TASK,
        anatomies=(0,),
        settings=replace(tiny, evaluate_every=160),
        seed=0,
        origin=Origin("unseen", "roadmap", 0, "desk"),
        tests=TESTS,
        starts=tmp_path / "starts",
        validated=(2,),
    )
    told = train_roadmap(teacher, Report())
    assert told["tests"][0]["n"] == 1
    log = teacher.folder / "evaluation" / "unseen" / "lcca" / "deterministic" / "random_1" / "000.mcap"
    written = log.stat().st_mtime_ns
    again = train_roadmap(teacher, Report())
    assert again["tests"] == told["tests"]
    assert log.stat().st_mtime_ns == written

    # stopped after its first round, then gone on with: the same student as without the stop
    messages = iter(range(10**6))

    class Stopped(Report):
        def __call__(self, fraction: float, text: str = "") -> None:
            next(messages)
            if (student.folder / "training.csv").is_file() and text.startswith("lessons round 2"):
                raise KeyboardInterrupt

    student = student_job(tmp_path, rounds=2)
    with pytest.raises(KeyboardInterrupt):
        train_student(student, Stopped())
    assert (student.folder / "lessons" / "round0.npz").is_file()
    outcome = train_student(student, Report())
    whole = replace(student, folder=tmp_path / "other", tests=())
    train_student(whole, Report())
    weights = [np.frombuffer(_weights(folder), np.uint8) for folder in (student.folder, whole.folder)]
    np.testing.assert_array_equal(*weights)
    record = json.loads((student.folder / "training.json").read_text())
    assert [row["round"] for row in record["rounds"]] == [0, 1]
    assert not (student.folder / "lessons").exists()

    tables = tables_from_logs(tmp_path / "unseen")
    assert set(tables["generalisation"]) == {"roadmap/lcca/unseen", "image/lcca/unseen"}
    jobs = [
        job for job in plan(settings(targets=["lcca"], curve=[]), tmp_path, 0) if job.key in ("roadmap tests", "image")
    ]
    rows = curve(jobs, {"roadmap tests": told, "image": outcome})
    assert rows["roadmap/8"]["success_lcca_pct"] == told["tests"][0]["success_pct"]
    assert list(rows) == ["roadmap/8", "image/20"]


def _weights(folder: Path) -> bytes:
    from enn.student import ImageStudent

    state = ImageStudent.load(folder / "student.pt").network.state_dict()
    return b"".join(value.numpy().tobytes() for value in state.values())
