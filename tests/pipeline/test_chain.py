"""The chain of stages: order, estimates, how it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from pipeline import chain
from pipeline.config import BUDGETS
from pipeline.stages import available_stages
from pipeline.store.manifest import read_manifest


def start(pipeline_process, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "pipeline.chain", *arguments, f"runs_dir={pipeline_process.runs}"],
        env=pipeline_process.environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip


def test_stages_run_in_order_and_are_told(pipeline_process) -> None:
    process = start(pipeline_process, "user_study", "report", "--", "budget=smoke", "name=run")
    told, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors
    lines = [line for line in told.splitlines() if line.startswith("==")]
    assert lines[0].startswith("== stage 1 of 2: user_study; about ")
    assert lines[0].endswith(" left in all")
    assert lines[1].startswith("== stage 2 of 2: report; about ")
    assert lines[2].startswith("== all 2 stages in ")
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


def test_what_is_no_stage_is_refused() -> None:
    for arguments, problem in ((("phantoms", "phantom"), "unknown stage 'phantom'"), ((), "no stage is named")):
        done = subprocess.run(
            [sys.executable, "-m", "pipeline.chain", *arguments], capture_output=True, text=True, check=False
        )
        assert done.returncode == 2
        assert done.stderr.startswith(f"{problem}: choose from all, phantoms, ")


def test_the_estimate_follows_the_machine() -> None:
    known = {"phantoms": 1.0, "enn": 40.0, "unseen": 60.0}
    assert chain.minutes_left(["unseen"], [], known) == pytest.approx(60.0)
    twice_as_slow = chain.minutes_left(["unseen"], [("enn", 80.0)], known)
    assert twice_as_slow is not None
    assert 110 < twice_as_slow < 120
    # a short stage says little, one that was up to date nothing
    after_short = chain.minutes_left(["unseen"], [("phantoms", 2.0)], known)
    assert after_short is not None
    assert 60 < after_short < 85
    assert chain.minutes_left(["unseen"], [("enn", 0.1)], known) == pytest.approx(60.0)
    assert chain.minutes_left(["unseen", "shape"], [], known) is None


@pytest.mark.parametrize("budget", ["smoke", "desk"])
def test_every_stage_of_measured_budgets_is_known(budget: str) -> None:
    assert set(chain.known_minutes([f"budget={budget}"])) == set(available_stages())


def test_what_was_not_measured_is_not_guessed() -> None:
    assert chain.known_minutes(["budget=none"]) == {}
    assert all(isinstance(chain.known_minutes([f"budget={budget}"]), dict) for budget in BUDGETS)
    assert chain.known_minutes([]) == chain.known_minutes(["budget=desk"])


@pytest.mark.parametrize(
    ("minutes", "words"), [(0.5, "30 s"), (12.4, "12 min"), (59.6, "1 h 00 min"), (125, "2 h 05 min")]
)
def test_durations_are_worded(minutes: float, words: str) -> None:
    assert chain.worded(minutes) == words


def test_settings_of_a_stage_go_to_the_stages_that_have_them(pipeline_process) -> None:
    assert chain.concerns("stage.device=cuda", "enn")
    assert not chain.concerns("stage.device=cuda", "phantoms")
    assert chain.concerns("++stage.task.max_steps=5", "expert")
    assert not chain.concerns("stage.task.max_steps=5", "shape")
    assert chain.concerns("stage@enn.decisions=5", "enn")
    assert not chain.concerns("stage@enn.decisions=5", "baselines")
    assert not chain.concerns("stage@enn.nothing=5", "enn")
    assert chain.concerns("budget=smoke", "phantoms")
    process = start(
        pipeline_process, "user_study", "report", "--", "budget=smoke", "name=run", "stage@report.embed_limit_mb=2"
    )
    told, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors + told
    manifest = read_manifest(pipeline_process.runs / "run" / "report")
    assert manifest is not None
    assert manifest.config["embed_limit_mb"] == 2.0
    process = start(pipeline_process, "user_study", "report", "--", "budget=smoke", "stage.devise=cuda")
    told, errors = process.communicate(timeout=120)
    assert process.returncode == 2
    assert errors.strip() == (
        "no stage of the chain has the setting 'stage.devise=cuda': name its stage, or leave it out"
    )


def test_several_seeds_repeat_the_stages_whose_figures_depend_on_them() -> None:
    steps = chain.steps_of(["phantoms", "shape", "report"], 3)
    assert list(map(str, steps)) == ["phantoms", "shape", "shape with seed 1", "shape with seed 2", "report"]
    assert chain.steps_of(["shape"], 1) == [chain.Step("shape")]
    repeated = [step.stage for step in chain.steps_of(available_stages(), 2) if step.seed == 1]
    assert repeated == ["imitation", "force", "unseen", "shape", "splineformer", "navigation"]


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["--seeds", "0", "report"], "--seeds needs a whole number from 1 to 20, got '0'"),
        (["report", "--seeds"], "--seeds needs a whole number from 1 to 20, got 'nothing'"),
        (["--seeds", "2", "report", "--", "seed=4"], "--seeds counts from seed 0 on: leave seed=… out, or --seeds"),
    ],
)
def test_seeds_that_cannot_be_are_refused(words: list[str], problem: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert chain.main(words) == 2
    assert capsys.readouterr().err.strip() == problem
