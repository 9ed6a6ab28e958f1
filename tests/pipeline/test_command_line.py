"""The command line: wrong settings give one line with the valid ones, --help lists stages and budgets."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from pipeline.chain import after_inputs
from pipeline.config import BUDGETS, CONFIG_DIRECTORY
from pipeline.launch import main
from pipeline.printing import say
from pipeline.stages import available_stages
from pipeline.store.errors import StageError
from pipeline.store.variants import RunRequest, require_input

WRONG = {
    "no stage": ((), ["no stage given", "phantoms", "report"]),
    "stage": (("stage=phantom",), ["'phantom'", "phantoms", "report"]),
    "budget": (("stage=phantoms", "budget=huge"), ["'huge'", *BUDGETS]),
    "experiment": (("stage=phantoms", "experiment=nothing"), ["'nothing'", "demo"]),
    "launcher": (("stage=phantoms", "hydra/launcher=cloud"), ["'cloud'", "joblib", "submitit_local"]),
    "phantom": (("stage=phantoms", "stage.phantoms=[type_9]"), ["'type_9'", "type_1", "bovine"]),
    "key": (("stage=phantoms", "sed=3"), ["'sed'", "did you mean seed?", "budget"]),
    "added key": (("stage=phantoms", "+sed=3"), ["'sed'", "budget"]),
    "number of a stage": (("stage=5",), ["unknown stage '5'", "choose one of phantoms"]),
    "number of a budget": (("stage=report", "budget=5"), ["unknown budget '5'", "choose one of smoke, desk, thesis"]),
    "task as a whole": (("stage=enn", "task=5"), ["task has several settings", "task.wire=…", "task.max_steps=…"]),
    "task by name": (("stage=enn", "task=thesis"), ["task has several settings", "task.wire=…"]),
    "task's key": (("stage=enn", "task.max_step=5"), ["'task.max_step'", "did you mean task.max_steps?"]),
    "stage's task's key": (("stage=unseen", "stage.task.wires=5"), ["did you mean stage.task.wire?"]),
    "stage key": (("stage=phantoms", "stage.size=3"), ["'stage.size'", "stage.resolution_mm"]),
    "type": (("stage=phantoms", "seed=many"), ["seed", "'many'", "Integer"]),
    "seed": (("stage=phantoms", "seed=-1"), ["seed must be 0 or more, got -1"]),
    "size": (("stage=phantoms", "stage.resolution_mm=0"), ["stage.resolution_mm must be 0.1 or more, got 0.0"]),
    "name": (("stage=phantoms", "name=a/b"), ["name cannot be 'a/b'", "it becomes a folder"]),
    "quoting": (("stage=phantoms", "stage.phantoms=[type_1"), ["stage.phantoms=[type_1", "key=value"]),
    "sweep": (("-m", "stage=phantom,report"), ["'phantom'", "phantoms", "report"]),
    "experiment of another stage": (("stage=report", "experiment=demo"), ["'stage.phantoms'", "stage.embed_limit_mb"]),
    "sweep key": (("-m", "stage=phantoms", "sed=1,2"), ["'sed'", "did you mean seed?"]),
}


@pytest.mark.parametrize("case", list(WRONG))
def test_wrong_setting_is_explained_in_one_line(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    overrides, expected = WRONG[case]
    assert main([*overrides, f"runs_dir={tmp_path}"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    for words in expected:
        assert words in line
    assert not list(tmp_path.rglob("manifest.json"))


def test_failing_sweep_job_is_named_and_the_others_finish(pipeline_process) -> None:
    done = pipeline_process.run("-m", "stage=report", "stage.embed_limit_mb=-1,1", "name=sweep")
    assert done.returncode == 2
    assert "stage.embed_limit_mb=-1 failed: stage.embed_limit_mb must be 0 or more" in done.stdout
    assert "Traceback" not in done.stderr
    assert (pipeline_process.runs / "sweep" / "report@stage.embed_limit_mb=1" / "manifest.json").is_file()


def test_help_lists_stages_and_budgets(pipeline_process) -> None:
    done = pipeline_process.run("--help")
    assert done.returncode == 0
    for word in (*available_stages(), *BUDGETS, "demo", "--multirun"):
        assert word in done.stdout


def test_a_stage_without_its_input_names_the_command_to_run(tmp_path: Path) -> None:
    request = RunRequest(("stage=enn", "budget=smoke", "stage.workers=1"), budget="smoke")
    with pytest.raises(StageError, match="holds none: run `") as refused:
        require_input(tmp_path / "smoke", "expert", "enn", request)
    shown = shlex.split(str(refused.value).split("`")[1])
    own = ["budget=smoke", "stage@enn.workers=1", "name=smoke", f"runs_dir={tmp_path}"]
    assert shown == ["python", "-m", "pipeline.chain", "--inputs", "enn", "--", *own]
    assert set(after_inputs(["enn"])) > {"expert", "enn"}


@pytest.mark.parametrize("file", sorted(CONFIG_DIRECTORY.rglob("*.yaml")), ids=lambda p: p.stem)
def test_configuration_holds_no_code_references(file: Path) -> None:
    assert "_target_" not in file.read_text(encoding="utf-8")


def test_every_stage_has_settings_and_every_budget_serves_every_stage() -> None:
    assert {p.stem for p in (CONFIG_DIRECTORY / "stage").glob("*.yaml")} == set(available_stages())
    assert {p.stem for p in (CONFIG_DIRECTORY / "budget").glob("*.yaml")} == set(BUDGETS)
    keys = [set(OmegaConf.load(CONFIG_DIRECTORY / "budget" / f"{name}.yaml")) for name in BUDGETS]
    assert keys[0] == keys[1] == keys[2]


def test_a_missing_package_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    import pipeline.stages as stages

    def import_module(name: str) -> None:
        raise ModuleNotFoundError("No module named 'mujoco'", name="mujoco")

    monkeypatch.setattr(stages.importlib, "import_module", import_module)
    with pytest.raises(StageError, match="stage phantoms needs the module 'mujoco', which is not installed: run `make"):
        stages.load_stage("phantoms")


def test_a_stage_whose_input_was_damaged_stops_and_names_the_command_that_mends_it(pipeline_process) -> None:
    make = ("stage=phantoms", "stage.phantoms=[type_1]", "stage.picture=false", "stage.resolution_mm=2.5", "name=run")
    assert pipeline_process.run_here(*make).returncode == 0
    folder = pipeline_process.runs / "run" / "phantoms"
    for damage in (lambda: shutil.rmtree(folder / "type_1"), lambda: flip(folder / "type_1" / "lumen.stl")):
        damage()
        done = pipeline_process.run_here("stage=expert", "name=run", "stage.phantoms=[type_1]", "stage.targets=[bca]")
        assert done.returncode == 2
        (line,) = done.stderr.strip().splitlines()
        assert f"stage expert cannot read stage phantoms: {folder / 'type_1'}" in line
        command = shlex.split(re.search(r"`python -m pipeline (.*)`", line)[1])
        assert {*make, "force=true"} <= set(command)
        mended = pipeline_process.run_here(*(word for word in command if not word.startswith(("runs_dir=", "force="))))
        assert mended.returncode == 0
        assert "so the stage runs again" in mended.stdout  # without force=true, too
        assert "up to date" in pipeline_process.run_here(*make).stdout


def flip(file: Path) -> None:
    """Flips one bit of a file."""
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)


LEFT = "import sys; from pipeline.printing import say; sys.stdin.read(); say('first'); say('second'); sys.exit(3)"


def test_a_reader_that_has_gone_is_no_error() -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", LEFT], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdin is not None
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()  # as `head` does
    process.stdin.close()
    assert process.stderr.read() == ""
    assert process.wait(60) == 3


def test_texts_go_where_they_belong(capfd: pytest.CaptureFixture[str]) -> None:
    say("a result\n")
    say("an error", error=True)
    assert capfd.readouterr() == ("a result\n", "an error\n")
