"""The command line of a chain: order, how it ends, what it refuses."""

from __future__ import annotations

import os
import signal
import time

import pytest

from pipeline.chain import main
from pipeline.store.manifest import read_manifest
from tests.pipeline.chain.starting import start


def test_stages_run_in_order_and_are_told(pipeline_process) -> None:
    words = ("user_study", "report", "--", "budget=smoke", "name=run", "stage@report.embed_limit_mb=2")
    process = start(pipeline_process, *words)
    told, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors
    lines = [line for line in told.splitlines() if line.startswith("==")]
    assert lines[0] == "== stage 1 of 2: user_study"
    assert lines[1].startswith("== stage 2 of 2: report; 1 done in ")
    assert lines[2].startswith("== all 2 stages in ")
    manifest = read_manifest(pipeline_process.runs / "run" / "report")
    assert manifest is not None
    assert manifest.config["embed_limit_mb"] == 2.0  # a setting goes to the stages that have it
    assert (pipeline_process.runs / "run" / "report" / "index.html").is_file()


def test_the_first_stage_that_fails_ends_it(pipeline_process) -> None:
    process = start(pipeline_process, "enn", "report", "--", "budget=smoke", "name=run")
    told, errors = process.communicate(timeout=120)
    assert process.returncode == 2
    assert "expert" in errors.strip().splitlines()[-1]  # which is missing
    assert "report" not in told
    assert not (pipeline_process.runs / "run" / "report").exists()


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_the_stage_and_starts_no_other(number: signal.Signals, code: int, pipeline_process) -> None:
    process = start(pipeline_process, "phantoms", "report", "--", "budget=desk", "name=run")
    try:
        progress = pipeline_process.runs / "run" / "phantoms" / ".progress"
        deadline = time.monotonic() + 60
        while not list(progress.glob("item-*.json")):
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < deadline
            time.sleep(0.02)
        if number == signal.SIGINT:
            os.killpg(process.pid, number)  # a terminal sends it to the stage, too
        else:
            process.send_signal(number)
        told, errors = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == code
    assert "Traceback" not in errors
    assert "stage 2" not in told
    assert not (pipeline_process.runs / "run" / "phantoms" / "manifest.json").exists()


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["--seeds", "0", "report"], "--seeds needs a whole number from 1 to 20, got '0'"),
        (["report", "--seeds"], "--seeds needs a whole number from 1 to 20, got 'nothing'"),
        (["--beside", "65", "report"], "--beside needs a whole number from 1 to 64, got '65'"),
        (["--seeds", "2", "report", "--", "seed=4"], "--seeds counts from seed 0 on: leave seed=… out, or --seeds"),
        (["all", "name=a"], "name=a is no stage: settings stand behind --, after the stages"),
        (["phantoms", "phantom"], "unknown stage 'phantom': choose from all, phantoms, "),
        ([], "no stage is named: choose from all, phantoms, "),
        (
            ["user_study", "report", "--", "stage.devise=cuda"],
            "no stage of the chain has the setting 'stage.devise=cuda': name its stage, or leave it out",
        ),
    ],
)
def test_what_cannot_be_is_refused(words: list[str], problem: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(problem)
