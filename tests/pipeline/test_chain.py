"""Chains of stages: steps, the command line, stages beside each other, and how a chain ends."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from signal import SIGINT, SIGTERM

import pytest

from pipeline.chain import Step, concerns, main, steps_of, steps_to_the_end, waits_for, worded
from pipeline.stages import available_stages
from pipeline.store.manifest import read_manifest
from tests.conftest import PipelineProcess
from tests.pipeline.waiting import wait_until

COARSE = ("stage@phantoms.picture=false", "stage@phantoms.resolution_mm=2.5")


def test_settings_concern_the_stages_that_have_them() -> None:
    assert concerns("stage.device=cuda", "enn")
    assert not concerns("stage.device=cuda", "phantoms")
    assert concerns("++stage.task.max_steps=5", "expert")
    assert not concerns("stage.task.max_steps=5", "shape")
    assert concerns("stage@enn.decisions=5", "enn")
    assert not concerns("stage@enn.decisions=5", "baselines")
    assert not concerns("stage@enn.nothing=5", "enn")
    assert concerns("budget=smoke", "phantoms")


def test_several_seeds_repeat_the_stages_whose_figures_depend_on_them() -> None:
    steps = steps_of(["phantoms", "shape", "report"], 3)
    assert list(map(str, steps)) == ["phantoms", "shape", "shape with seed 1", "shape with seed 2", "report"]
    assert steps_of(["shape"], 1) == [Step("shape")]
    repeated = [step.stage for step in steps_of(available_stages(), 2) if step.seed == 1]
    assert repeated == ["imitation", "force", "unseen", "shape", "splineformer", "navigation"]


def test_a_step_waits_for_what_it_reads_and_the_report_for_all() -> None:
    steps = steps_of(
        ["phantoms", "guide3d", "segmentation", "shape", "splineformer", "unseen", "rehearsal", "report"], 2
    )
    needs = {str(step): [str(steps[k]) for k in waits_for(steps, place)] for place, step in enumerate(steps)}
    assert needs["guide3d"] == []
    assert needs["shape with seed 1"] == ["guide3d"]
    assert needs["splineformer"] == ["guide3d", "segmentation"]
    assert needs["rehearsal"] == ["unseen", "unseen with seed 1"]
    assert needs["report"] == list(needs)[:-1]


def test_the_longest_chain_of_steps_that_wait_for_each_other() -> None:
    steps = [Step("phantoms"), Step("expert"), Step("enn"), Step("guide3d"), Step("shape"), Step("report")]
    assert steps_to_the_end(steps) == [4, 3, 2, 3, 2, 1]
    # the same stage with other seeds is not waited for
    assert steps_to_the_end([Step("shape"), Step("shape", 1)]) == [1, 1]


@pytest.fixture
def ended(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Runs a chain in this process to its end; gives its exit code, and what it and its stages said."""

    def run(*arguments: str) -> tuple[int, str, str]:
        code = main([*arguments, f"runs_dir={tmp_path}"])
        return code, *capfd.readouterr()

    return run


def test_stages_that_do_not_need_each_other_run_at_the_same_time(ended, tmp_path: Path) -> None:
    words = ("phantoms", "user_study", "report", "--", "budget=smoke", "name=run", "stage@report.embed_limit_mb=2")
    code, told, errors = ended("--beside", "2", *words, *COARSE)
    assert code == 0, errors
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
    manifests = [read_manifest(tmp_path / "run" / name) for name in ("phantoms", "user_study", "report")]
    phantoms, study, report = (manifest for manifest in manifests if manifest is not None)
    assert report.finished >= max(phantoms.finished, study.finished)
    assert report.config["embed_limit_mb"] == 2.0  # a setting goes to the stages that have it
    assert (tmp_path / "run" / "report" / "index.html").is_file()


def test_the_failure_of_one_stops_those_beside_it(ended, tmp_path: Path) -> None:
    code, told, errors = ended("--beside", "2", "guide3d", "enn", "report", "--", "budget=desk", "name=run")
    assert code == 2
    assert any(line.startswith("enn | ") and "expert" in line for line in errors.splitlines())
    assert "report" not in told
    assert not (tmp_path / "run" / "guide3d" / "manifest.json").exists()
    assert "Traceback" not in errors


def test_ctrl_c_ends_all_of_them(pipeline_process) -> None:
    process = start(pipeline_process, "--beside", "2", "phantoms", "guide3d", "--", "budget=desk", "name=run")
    folders = [pipeline_process.runs / "run" / name for name in ("phantoms", "guide3d")]
    # a terminal sends it to the stages, too
    _, errors = stopped(process, lambda: all((folder / ".lock").exists() for folder in folders), os.killpg, SIGINT)
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert not any((folder / "manifest.json").exists() for folder in folders)


def test_durations_are_worded() -> None:
    found = [worded(minutes) for minutes in (0.5, 12.4, 59.6, 125)]
    assert found == ["30 s", "12 min", "1 h 00 min", "2 h 05 min"]


def test_stages_run_in_order_and_the_first_that_fails_ends_it(ended, tmp_path: Path) -> None:
    code, told, errors = ended("user_study", "baselines", "report", "--", "budget=smoke", "name=run")
    assert code == 2
    lines = [line for line in told.splitlines() if line.startswith("==")]
    assert lines[0] == "== stage 1 of 3: user_study"
    assert lines[1].startswith("== stage 2 of 3: baselines; 1 done in ")
    assert "expert" in errors.strip().splitlines()[-1]  # which is missing
    assert len(lines) == 2
    assert not (tmp_path / "run" / "report").exists()


def test_a_signal_ends_the_stage_and_starts_no_other(pipeline_process) -> None:
    process = start(pipeline_process, "phantoms", "report", "--", "budget=desk", "name=run", *COARSE)
    folder = pipeline_process.runs / "run" / "phantoms"
    told, errors = stopped(process, lambda: any(folder.glob(".progress/item-*.json")), os.kill, SIGTERM)
    assert process.returncode == 143
    assert "Traceback" not in errors
    assert "stage 2" not in told
    assert not (folder / "manifest.json").exists()


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["--seeds", "0", "report"], "--seeds needs a whole number from 1 to 20, got '0'"),
        (["--beside", "65", "report"], "--beside needs a whole number from 1 to 64, got '65'"),
        (["--seeds", "2", "report", "--", "seed=4"], "--seeds counts from seed 0 on: leave seed=… out, or --seeds"),
        (["all", "name=a"], "name=a is no stage: settings stand behind --, after the stages"),
        (["phantoms", "phantom"], "unknown stage 'phantom': choose from all, phantoms, "),
        ([], "no stage is named: choose from all, phantoms, "),
        (["user_study", "report", "--", "stage.devise=cuda"], "no stage of the chain has the setting 'stage.devise="),
        (
            ["phantoms", "unseen", "--", "budget=smoke", "pretrained=true", "stage@unseen.policy=mine.pt"],
            "unseen: stage.shipped=true",
        ),
        *(
            (
                ["--inputs", stage, "--", "budget=smoke", f"stage@{stage}.training={{{wrong}}}"],
                f"{stage}: stage.training",
            )
            for stage in ("enn", "baselines")
            for wrong in ("foo: 1", "learning_rate: -1")
        ),
    ],
)
def test_what_cannot_be_is_refused(words: list[str], problem: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(problem)


def start(pipeline_process: PipelineProcess, *arguments: str) -> subprocess.Popen[str]:
    """A chain in a process group of its own, which a test may interrupt."""
    return subprocess.Popen(
        [sys.executable, "-m", "pipeline.chain", *arguments, f"runs_dir={pipeline_process.runs}"],
        env=pipeline_process.environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip


def stopped(
    process: subprocess.Popen[str], ready: Callable[[], bool], kill: Callable[[int, int], None], number: int
) -> tuple[str, str]:
    """What a chain says that gets a signal, for itself or its group, as soon as it is ready for it."""
    try:
        wait_until(ready, process)
        kill(process.pid, number)
        return process.communicate(timeout=90)
    finally:
        process.kill()
