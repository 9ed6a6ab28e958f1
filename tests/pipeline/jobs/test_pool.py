"""Jobs: beside each other, resumable one by one, stopped cleanly, and named when they fail."""

import json
import logging
import os
import platform
import signal
import subprocess
import sys
import time
from multiprocessing import forkserver
from pathlib import Path

import pytest

from pipeline.jobs.display import JobDisplay
from pipeline.jobs.pool import Job, run_jobs
from pipeline.jobs.worker import Message, Report
from pipeline.store.costs import kept_costs
from pipeline.store.errors import StageError
from pipeline.store.run_folder import Identity, RunFolder
from tests.pipeline.jobs.toy_training import Toy, opencv_threads, square, train
from tests.pipeline.waiting import wait_until

TEST_ROOT = Path(__file__).resolve().parents[3]


def test_jobs_run_in_processes_of_their_own_and_leave_their_results(folder: RunFolder, caplog) -> None:
    caplog.set_level(logging.INFO)
    jobs = [Job(name, train, Toy(folder.path / name)) for name in ("a", "b")]
    results = run_jobs(folder, [*jobs, Job("c", square, 7, after=("a", "b"))], workers=2, label="toys")
    assert results["c"] == 49
    assert {results["a"]["count"], results["b"]["count"]} == {3}
    assert len({results["a"]["process"], results["b"]["process"], os.getpid()}) == 3
    assert results["a"]["threads"] == "1"
    assert any("toys 3/3" in record.getMessage() for record in caplog.records)


def test_jobs_use_one_thread_of_opencv(folder: RunFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    assert run_jobs(folder, [Job("a", opencv_threads)], preload=["guide3d.opencv"]) == {"a": 1}


def test_the_modules_of_jobs_are_imported_before_their_processes(folder: RunFolder, monkeypatch) -> None:
    preloads: list[list[str]] = []
    monkeypatch.setattr(forkserver, "set_forkserver_preload", preloads.append)
    run_jobs(folder, [Job("a", square, 2)], preload=["json"])
    assert {square.__module__, "json"} <= set(preloads[0])


def test_what_jobs_cost_stands_in_the_manifest_also_after_an_interruption(folder: RunFolder, tmp_path: Path) -> None:
    toys = [Job("good", train, Toy(tmp_path / "good")), Job("bad", train, Toy(tmp_path / "bad", fails="sentence"))]
    with pytest.raises(StageError, match="bad"):
        run_jobs(folder, toys)
    kept = kept_costs(folder.path)
    assert kept["good"]["outcome"] == "ok"
    assert kept["bad"]["outcome"] == "the toy is broken: mend it"
    again = RunFolder(folder.path, folder.identity)
    again.prepare()
    run_jobs(again, [toys[0], Job("bad", square, 2)])
    manifest = again.finish(stage="s", run="r", budget="b", seed=0, config={}, started=time.monotonic())
    assert manifest.jobs["good"] == kept["good"]
    assert {key: cost["outcome"] for key, cost in manifest.jobs.items()} == {"good": "ok", "bad": "ok"}
    for cost in manifest.jobs.values():
        assert cost["wall_s"] >= 0
        assert 10 < cost["memory_mb"] < 10_000
        assert (cost["device"], cost["gpu_mb"]) == ("cpu", 0)
    assert not any("jobs" in name for name in manifest.outputs)


def test_a_job_waits_for_those_it_needs(folder: RunFolder, tmp_path: Path) -> None:
    jobs = [Job("first", train, Toy(tmp_path / "first", fails="sentence")), Job("second", square, 2, after=("first",))]
    with pytest.raises(StageError, match=r"2 of 2 .*first \(the toy is broken.*; second \(it needs first\)"):
        run_jobs(folder, jobs)
    with pytest.raises(ValueError, match="job second waits for first: list those before it"):
        run_jobs(folder, jobs[::-1])


def test_a_failing_or_killed_job_stops_no_other_and_is_named(folder: RunFolder, tmp_path: Path, caplog) -> None:
    jobs = [
        Job("error", train, Toy(tmp_path / "error", fails="error")),
        Job("refusal", train, Toy(tmp_path / "refusal", fails="refusal")),
        Job("disk", train, Toy(tmp_path / "disk", fails="disk")),
        Job("kill", train, Toy(tmp_path / "kill", fails="kill")),
        Job("good", train, Toy(tmp_path / "good")),
    ]
    with pytest.raises(StageError, match="4 of 5 toys failed") as raised:
        run_jobs(folder, jobs, workers=1, label="toys")
    assert "error (ZeroDivisionError: a toy's trouble)" in str(raised.value)
    assert "refusal (Fit.epochs must be greater than 0, got -1)" in str(raised.value)
    assert "disk (no room left while writing weights.pt: free some space" in str(raised.value)
    assert not any(words in caplog.text for words in ("ValidationError", "No space left on device"))  # no traceback
    assert "kill (its process was killed by signal 9)" in str(raised.value)
    assert folder.result_of("good")["count"] == 3
    assert "in train" in caplog.text  # where it failed stands in the log
    mended = [Job(job.key, train, Toy(tmp_path / job.key)) for job in jobs]
    again = run_jobs(folder, mended, workers=2)
    assert again["good"] == folder.result_of("good")
    assert again["error"]["count"] == 3


def start_toys(root: Path, *, steps: int = 60, checkpoint_every: int = 1) -> subprocess.Popen[str]:
    code = (
        "import signal, sys, logging\n"
        "from pathlib import Path\n"
        "from pipeline.store.interruption import let_ctrl_c_interrupt\n"
        "from tests.pipeline.jobs.toy_training import run_toys\n"
        "logging.basicConfig(level=logging.INFO)\n"
        "let_ctrl_c_interrupt()\n"
        "signal.signal(signal.SIGTERM, lambda *a: sys.exit(143))\n"
        f"run_toys(Path({str(root)!r}), ['a', 'b', 'c'], {steps}, 0.05, {checkpoint_every})\n"
    )
    return subprocess.Popen(
        [sys.executable, "-c", code], cwd=TEST_ROOT, text=True, stderr=subprocess.PIPE, start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip


def count(root: Path, name: str) -> int:
    try:
        return json.loads((root / name / "checkpoint.json").read_text())
    except (FileNotFoundError, ValueError):
        return 0


@pytest.mark.parametrize(("number", "whole_group"), [(signal.SIGINT, True), (signal.SIGTERM, False)])
def test_a_stopped_stage_lets_its_jobs_write_their_checkpoints(
    number: signal.Signals, whole_group: bool, tmp_path: Path
) -> None:
    root = tmp_path / "stage"
    process = start_toys(root, checkpoint_every=1000)  # only a clean stop leaves one
    wait_until(lambda: (root / "a" / "started").exists() and (root / "b" / "started").exists(), process)
    time.sleep(0.3)
    (os.killpg if whole_group else os.kill)(process.pid, number)
    _, stderr = process.communicate(timeout=60)
    assert count(root, "a") > 0
    assert count(root, "b") > 0
    assert not (root / "c").exists()
    assert stderr.count("Traceback") <= (number == signal.SIGINT)  # the stage's own KeyboardInterrupt; no job's
    assert process.returncode != 0


def test_a_killed_stage_takes_its_jobs_along_and_the_next_run_goes_on(tmp_path: Path) -> None:
    root = tmp_path / "stage"
    process = start_toys(root, steps=40)
    wait_until(lambda: min(count(root, "a"), count(root, "b")) >= 5, process)
    process.kill()
    process.communicate(timeout=60)
    time.sleep(0.3)
    left = {name: count(root, name) for name in "ab"}
    time.sleep(0.3)
    assert left == {name: count(root, name) for name in "ab"}, "a job outlived its stage"
    folder = RunFolder(root, Identity("c", {}, 1))
    with folder.locked():
        folder.prepare()
        results = run_jobs(folder, [Job(name, train, Toy(root / name, 40)) for name in "abc"], workers=2)
    assert {name: results[name]["began"] for name in "abc"} == {**left, "c": 0}
    assert {result["count"] for result in results.values()} == {40}


def test_estimate_of_the_end() -> None:
    display = JobDisplay("toys", "abcd", "abc")
    assert display.remaining_s() is None
    now = time.monotonic()
    for state in (display.states["a"], display.states["b"]):
        state.start()
        state._started = now - 10.0
        state.update(0.0, "")
        state.update(0.5, "half")
    assert display.remaining_s() == pytest.approx(20.0, abs=0.5)
    assert display.line().startswith("toys 1/4, 2 running: a 50 % (half), b 50 % (half); ")


def test_what_was_done_by_an_earlier_run_is_no_pace() -> None:
    display = JobDisplay("toys", "ab", "a")
    assert display.remaining_s() is None
    assert display.line().startswith("toys 1/2; ")
    state = display.states["a"]
    state.start()
    state._started -= 10.0
    state.update(0.8, "")
    assert state.total_s() is None
    state.update(0.9, "")
    assert state.total_s() == pytest.approx(100.0, abs=1.0)


def test_a_report_is_throttled_and_stops_the_job() -> None:
    sent: list[Message] = []
    report = Report(sent.append)
    half = report.part(0.5, 1.0, "evaluation")
    for _ in range(100):
        half(0.5, "go")
    assert [(m.fraction, m.text) for m in sent] == [(0.75, "evaluation go")]
    report.stop()
    with pytest.raises(KeyboardInterrupt):
        half(0.6, "")


def test_jobs_import_no_package_of_learning(run_python) -> None:
    said = run_python(
        "import importlib, pkgutil, sys\n"
        "import pipeline.jobs\n"
        "for found in pkgutil.walk_packages(pipeline.jobs.__path__, 'pipeline.jobs.'):\n"
        "    importlib.import_module(found.name)\n"
        "print({'torch', 'numpy', 'enn', 'cathsim', 'guide3d', 'splineformer'} & set(sys.modules))\n"
    )
    assert said.strip() == "set()"


SCRIPT = """
import gc
from pathlib import Path
import mujoco
from pipeline.jobs.worker import map_simulations, return_freed_memory

def taken(kind="VmData"):
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith(kind)).split()[1]) / 1e3

map_simulations()
model = mujoco.MjModel.from_xml_string('<mujoco><size memory="16M"/></mujoco>')
for _ in range(3):  # what was freed before would move the C library's own threshold
    data = mujoco.MjData(model)
    del data
before, data = taken(), [mujoco.MjData(model) for _ in range(20)]
kept = data[-1]
data = None
gc.collect()
print(taken() - before)

many = [b"x" * (100_000 + k) for k in range(3000)]
kept, many = many[::100], None
before = taken("RssAnon")
return_freed_memory()
print(before - taken("RssAnon"))
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries return memory by themselves")
def test_freed_memory_goes_back() -> None:
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    left, returned = (float(line) for line in done.stdout.split())
    assert returned > 200  # MB of 297
    assert left < 40  # MB: one arena of 20
