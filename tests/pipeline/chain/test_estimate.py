"""Estimates of a chain: schedules of known jobs, the times of a run, what is not known."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

from pipeline.chain.estimate import TimedJob, TimedStage, critical_path, report, timed_stages
from pipeline.jobs.pool import Job, run_jobs
from pipeline.store.run_folder import Identity, RunFolder
from tests.pipeline.jobs.toy_training import square


def stage(*jobs: TimedJob, name: str = "enn", own: float = 0.0) -> TimedStage:
    return TimedStage(name, own, jobs, "table")


def test_a_schedule_fills_the_cores_and_waits_for_what_is_needed() -> None:
    jobs = [TimedJob("a", 3.0, 1.0), TimedJob("b", 2.0, 2.0), TimedJob("c", 1.0, 4.0, ("b",))]
    timed = stage(*jobs, own=0.5)
    assert timed.makespan(1) == pytest.approx(6.5)
    assert timed.makespan(2) == pytest.approx(3.5)
    assert timed.makespan(99) == pytest.approx(3.5)
    assert timed.hours == pytest.approx(6.5)
    assert (timed.memory_gb(1), timed.memory_gb(2), timed.memory_gb(9)) == (4.0, 6.0, 7.0)
    behind = stage(TimedJob("a", 1.0, 0.0), TimedJob("b", 5.0, 0.0, ("a",)))
    assert behind.makespan(2) == pytest.approx(6.0)


def test_the_critical_path_follows_what_stages_read() -> None:
    stages = [
        stage(TimedJob("a", 1.0, 0.0), name="phantoms"), stage(TimedJob("a", 2.0, 0.0), name="expert"),
        stage(TimedJob("a", 2.5, 0.0), name="guide3d"),
        stage(TimedJob("a", 4.0, 0.0), TimedJob("b", 4.0, 0.0), name="enn"),
    ]  # fmt: skip
    assert critical_path(stages) == (pytest.approx(7.0), ["phantoms", "expert", "enn"])


def test_a_run_gives_its_jobs_times_and_what_waited_for_what(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "run" / "enn", Identity("c", {}, 1))
    with folder.locked():
        folder.prepare()
        run_jobs(folder, [Job("a", square, 2), Job("b", square, 3, after=("a",))])
        folder.finish(stage="enn", run="run", budget="thesis", seed=0, config={}, started=time.monotonic())
    (timed,), unknown = timed_stages(["enn", "navigation"], "thesis", tmp_path / "run")
    assert timed.origin == "run run"
    assert {job.key: job.after for job in timed.jobs} == {"a": (), "b": ("a",)}
    assert all(0 <= job.hours < 0.01 and 0 < job.memory_gb < 2 for job in timed.jobs)
    assert unknown == ["navigation"]
    (other,), _ = timed_stages(["enn"], "desk", tmp_path / "run")  # a run of another budget says nothing
    assert other.origin == "minutes"


def test_the_table_of_the_thesis_is_of_its_trainings(tmp_path: Path) -> None:
    (enn, unet), _ = timed_stages(["enn", "segmentation"], "thesis", tmp_path / "none")
    assert len(enn.jobs) == 80
    assert enn.makespan(1) == pytest.approx(enn.hours)
    assert enn.makespan(10_000) == pytest.approx(max(job.hours for job in enn.jobs))
    assert len(unet.jobs) == 3
    text = report(["enn", "navigation"], "thesis", tmp_path / "none")
    assert "| enn | table | 80 |" in text
    assert "Not known, so left out: navigation." in text


@pytest.mark.parametrize(("budget", "words", "code"), [("smoke", "| report | minutes |", 0), ("none", "unknown", 2)])
def test_the_chain_prints_it_and_runs_nothing(budget: str, words: str, code: int, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "pipeline.chain", "--estimate", "user_study", "report", "--", f"budget={budget}",
         f"runs_dir={tmp_path / 'runs'}"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == code
    assert words in done.stdout + done.stderr
    assert not (tmp_path / "runs").exists()
