"""Stages beside each other: they share the cores, each line tells whose it is, and the report waits for all."""

from __future__ import annotations

import os
import signal
import time

import pytest

from pipeline.chain import worded
from pipeline.store.manifest import read_manifest
from tests.pipeline.chain.starting import start


def test_stages_that_do_not_need_each_other_run_at_the_same_time(pipeline_process) -> None:
    process = start(
        pipeline_process, "--beside", "2", "phantoms", "user_study", "report", "--", "budget=smoke", "name=run"
    )
    told, errors = process.communicate(timeout=240)
    assert process.returncode == 0, errors
    lines = told.splitlines()
    heads = [line.partition(";")[0] for line in lines if line.startswith("== ")]
    assert heads[:3] == ["== stage 1 of 3: phantoms", "== stage 2 of 3: user_study", "== stage 3 of 3: report"]
    assert heads[3].startswith("== all 3 stages in ")
    second = lines.index(next(line for line in lines if line.startswith("== stage 2")))
    assert not any("done in" in line for line in lines[:second])
    whole = lines + errors.splitlines()
    assert any(line.startswith("phantoms | ") and "done in" in line for line in whole)
    assert any(line.startswith("user_study | ") and "done in" in line for line in whole)
    assert all(line.startswith(("== ", "phantoms | ", "user_study | ", "report | ")) for line in whole if line)
    finished = [read_manifest(pipeline_process.runs / "run" / name) for name in ("phantoms", "user_study", "report")]
    assert None not in finished
    phantoms, study, report = (manifest.finished for manifest in finished if manifest is not None)
    assert report >= max(phantoms, study)


def test_the_failure_of_one_stops_those_beside_it(pipeline_process) -> None:
    process = start(pipeline_process, "--beside", "2", "phantoms", "enn", "report", "--", "budget=desk", "name=run")
    told, errors = process.communicate(timeout=240)
    assert process.returncode == 2
    assert any(line.startswith("enn | ") and "expert" in line for line in errors.splitlines())
    assert "report" not in told
    assert not (pipeline_process.runs / "run" / "phantoms" / "manifest.json").exists()
    assert "Traceback" not in errors


def test_ctrl_c_ends_all_of_them(pipeline_process) -> None:
    process = start(pipeline_process, "--beside", "2", "phantoms", "guide3d", "--", "budget=desk", "name=run")
    try:
        folders = [pipeline_process.runs / "run" / name for name in ("phantoms", "guide3d")]
        deadline = time.monotonic() + 120
        while not all((folder / ".lock").exists() for folder in folders):
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < deadline
            time.sleep(0.02)
        os.killpg(process.pid, signal.SIGINT)
        _, errors = process.communicate(timeout=90)
    finally:
        process.kill()
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert not any((folder / "manifest.json").exists() for folder in folders)


@pytest.mark.parametrize(
    ("minutes", "words"), [(0.5, "30 s"), (12.4, "12 min"), (59.6, "1 h 00 min"), (125, "2 h 05 min")]
)
def test_durations_are_worded(minutes: float, words: str) -> None:
    assert worded(minutes) == words
