"""The commands `endonav` and `python -m pipeline`: words go to what they name; what is wrong or refused is one line."""

import contextlib
import importlib.metadata
import io
import os
import platform
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from pipeline import command
from pipeline.chain import after_inputs
from pipeline.config import BUDGETS, CONFIG_DIRECTORY
from pipeline.launch import main, one_line
from pipeline.printing import CALLED
from pipeline.stages import available_stages
from pipeline.store.errors import StageError
from pipeline.store.provenance import PROJECT_ROOT
from pipeline.store.variants import RunRequest, require_input
from tests.conftest import process_kept


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", os.environ.get("MUJOCO_GL", "egl"))


@pytest.mark.parametrize("words", [[], ["--help"]])
def test_help_names_every_command(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(words) == (0 if words else 2)
    printed = capsys.readouterr().out
    assert all(f"\n  {name}" in printed for name in command._COMMANDS)


def test_an_unknown_command_is_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["stage"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("endonav has no command 'stage': choose from stages, chain, ")


def test_stages_and_chain_without_arguments_list_the_stages(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["stages"]) == 0
    assert "phantoms" in capsys.readouterr().out
    assert command.main(["chain"]) == 0
    assert "--inputs" in capsys.readouterr().out


def test_what_can_be_chosen_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["list"]) == 0
    printed = capsys.readouterr().out
    assert all(f"\n{name}:" in f"\n{printed}" for name in ("environments", "phantoms", "wires", "catheters", "models"))
    assert "cathsim/Navigate-v0" in printed
    assert "targets of type_1: bca, lcca" in printed


def test_a_file_of_yours_is_imported_read_or_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert command.main(["import"]) == 2
    assert "endonav import FILE" in capsys.readouterr().err
    assert command.main(["import", "no, file.stl"]) == 2
    assert "phantom.file=no, file.stl is no file" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="1"):
        command.main(["read", "nothing.png"])
    assert "nothing.png is missing" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        command.main(["read", "--help"])
    assert "endonav read A B --cameras" in capsys.readouterr().out


def test_a_training_is_a_stage_after_those_that_it_reads(monkeypatch: pytest.MonkeyPatch) -> None:
    called: list[list[str]] = []
    monkeypatch.setattr("pipeline.chain.main", lambda words: called.append(words) or 0)
    assert command.main(["train", "budget=smoke"]) == command.main(["train", "shape", "name=mine"]) == 0
    assert called == [["--inputs", "enn", "--", "budget=smoke"], ["--inputs", "shape", "--", "name=mine"]]
    assert command.main(["train", "user_study"]) == 2


def test_a_new_stage_is_named_by_absolute_paths_from_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clone, here = tmp_path / "my clone", tmp_path / "here"
    for folder in (clone / "tests", clone / "pipeline" / "stages", here):
        folder.mkdir(parents=True)
    (clone / "pipeline" / "stages" / "__init__.py").write_text('    "report": (\n')
    monkeypatch.setattr("pipeline.templates.PROJECT_ROOT", clone)
    for place, name, shown in ((here, "mine", f"{clone}/"), (clone, "other", "")):
        monkeypatch.chdir(place)
        assert command.main(["new", "stage", name]) == 0
        lines = capsys.readouterr().out.splitlines()
        assert lines[0] == f"{shown}conf/stage/{name}.yaml"
        assert lines[3].startswith(f"{shown}pipeline/stages/__init__.py: ")
        assert (f"cd '{clone}' && python" in lines[4]) == bool(shown)


def test_what_is_new_keeps_the_rules_of_lint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for folder in ("tests", "pipeline/stages"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "pipeline/stages/__init__.py").write_text('    "report": (\n')
    monkeypatch.setattr("pipeline.templates.PROJECT_ROOT", tmp_path)
    monkeypatch.chdir(tmp_path)
    for kind in ("stage", "policy", "phantom"):
        assert command.main(["new", kind, f"mine_with_{kind}"]) == 0
    Path("pipeline/stages/__init__.py").unlink()  # a line of it
    Path("pyproject.toml").write_bytes((PROJECT_ROOT / "pyproject.toml").read_bytes())
    for words in (["check"], ["format", "--check"]):
        done = subprocess.run([sys.executable, "-m", "ruff", *words, "."], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout


def test_a_new_policy_and_a_new_phantom_pass_their_tests(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert command.main(["new", "policy", "mine"]) == command.main(["new", "phantom", "my_arch"]) == 0
    words = [sys.executable, "-m", "pytest", "-q", "test_mine.py", "test_my_arch.py"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert "4 passed" in done.stdout
    written = (tmp_path / "mine.py").read_bytes()
    refused = {"mine": "there already", "3d": "no Python name", "class": "no Python name", "json": "installed module"}
    for name, sentence in refused.items():
        with pytest.raises(SystemExit) as ended:
            command.main(["new", "policy", name])
        assert ended.value.code == 2
        assert sentence in capsys.readouterr().err
    assert (tmp_path / "mine.py").read_bytes() == written


def test_models_are_listed_and_have_cards(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["models"]) == 0
    assert "guide3d reader: Finds guidewires" in capsys.readouterr().out
    assert command.main(["models", "splineformer"]) == 0
    assert {line.split()[0] for line in capsys.readouterr().out.splitlines()} == {"splineformer"}
    assert command.main(["models", "reader"]) == 0
    assert "\n# reader\n" in capsys.readouterr().out
    assert command.main(["models", "nothing"]) == 2
    assert "there is no model 'nothing': choose from " in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", [["episodes", "moon"], ["episodes", "info"], ["demo", "--seed", "5000"], ["demo", "x"]]
)
def test_wrong_arguments_are_one_line(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        command.main(words)
    assert caught.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(
    ("error", "said"),
    [
        ("No module named 'matplotlib'", "endonav console needs the module matplotlib"),
        ("pictures need matplotlib: pip install 'x[pictures]'", "endonav console: pictures need matplotlib: pip ins"),
    ],
)
def test_a_missing_package_is_one_sentence_and_says_what_to_install(
    error: str, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def missing(arguments: list[str]) -> int:
        raise ModuleNotFoundError(error, name="matplotlib")

    monkeypatch.setitem(command._COMMANDS, "console", missing)
    assert command.main(["console"]) == 2
    assert capsys.readouterr().err.startswith(said)


def test_the_version_is_that_of_the_distribution(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["--version"]) == 0
    declared = tomllib.loads((PROJECT_ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert capsys.readouterr().out == f"endonav {declared}\n"


def test_info_has_what_a_report_of_a_problem_needs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setenv("CATHSIM_CACHE", str(tmp_path))
    (tmp_path / "arch.npz").write_bytes(bytes(20_000_000))
    assert command.main(["info"]) == 0
    rows = dict(re.split(r"  +", line, maxsplit=1) for line in capsys.readouterr().out.splitlines())
    for name in ("endonav", "endonav-guide3d", "mujoco", "torch"):
        assert rows[name] == importlib.metadata.version(name)
    assert platform.python_version() in rows["python"]
    assert "cores" in rows["processor"]
    assert rows["anatomies in"] == f"{tmp_path}, 0.02 GB"
    assert re.match(r"egl (works|fails), osmesa (works|fails)", rows["rendering"])
    assert rows["GPUs"]


@pytest.mark.parametrize(
    "words", [["stages"], ["chain"], ["demo", "--help"], ["stages", "stage=navigation", "budget=smoke"]], ids=" ".join
)
def test_texts_of_the_command_name_it_and_nothing_of_a_clone(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(CALLED, "1")
    monkeypatch.chdir(tmp_path)
    with contextlib.suppress(SystemExit):
        command.main(words)
    said = "".join(capsys.readouterr())
    assert f"endonav {'chain' if 'stage=navigation' in words else words[0]}" in said
    assert not re.search(r"python -m pipeline|\bmake (setup|all|demo|ray)\b|\.venv", said), said


WRONG = {
    "no stage": ((), ["no stage given", "phantoms", "report"]),
    "stage": (("stage=phantom",), ["'phantom'", "phantoms", "report"]),
    "budget": (("stage=phantoms", "budget=huge"), ["'huge'", *BUDGETS]),
    "experiment": (("stage=phantoms", "experiment=nothing"), ["'nothing'", "demo"]),
    "launcher": (("stage=phantoms", "hydra/launcher=cloud"), ["'cloud'", "joblib", "submitit_local"]),
    "phantom": (("stage=phantoms", "stage.phantoms=[type_9]"), ["'type_9'", "type_1", "bovine"]),
    "key": (("stage=phantoms", "sed=3"), ["'sed'", "did you mean seed?"]),
    "added key": (("stage=phantoms", "+sed=3"), ["'sed'", "budget"]),
    "number of a stage": (("stage=5",), ["unknown stage '5'", "choose one of phantoms"]),
    "task as a whole": (("stage=enn", "task=5"), ["task has several settings", "task.wire=…", "task.max_steps=…"]),
    "task's key": (("stage=enn", "task.max_step=5"), ["'task.max_step'", "did you mean task.max_steps?"]),
    "stage's task's key": (("stage=unseen", "stage.task.wires=5"), ["did you mean stage.task.wire?"]),
    "stage key": (("stage=phantoms", "stage.size=3"), ["'stage.size'", "stage.resolution_mm"]),
    "type": (("stage=phantoms", "seed=many"), ["seed", "'many'", "Integer"]),
    "quoting": (("stage=phantoms", "stage.phantoms=[type_1"), ["stage.phantoms=[type_1", "key=value"]),
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
    done = pipeline_process.run_here("-m", "stage=report", "stage.embed_limit_mb=-1,1", "name=sweep")
    assert done.returncode == 2
    assert "stage.embed_limit_mb=-1 failed: stage.embed_limit_mb must be 0 or more" in done.stdout
    assert "Traceback" not in done.stderr
    assert (pipeline_process.runs / "sweep" / "report@stage.embed_limit_mb=1" / "manifest.json").is_file()


def test_a_stage_without_its_input_names_the_command_to_run(tmp_path: Path) -> None:
    request = RunRequest(("stage=enn", "budget=smoke", "stage.workers=1"), budget="smoke")
    with pytest.raises(StageError, match="holds none: run `") as refused:
        require_input(tmp_path / "smoke", "expert", "enn", request)
    shown = shlex.split(str(refused.value).split("`")[1])
    own = ["budget=smoke", "stage@enn.workers=1", "name=smoke", f"runs_dir={tmp_path}"]
    assert shown == ["python", "-m", "pipeline.chain", "--inputs", "enn", "--", *own]
    assert set(after_inputs(["enn"])) > {"expert", "enn"}


def test_configuration_holds_no_code_references() -> None:
    assert not [file for file in CONFIG_DIRECTORY.rglob("*.yaml") if "_target_" in file.read_text(encoding="utf-8")]


def test_every_stage_has_settings_and_every_budget_serves_every_stage() -> None:
    assert {p.stem for p in (CONFIG_DIRECTORY / "stage").glob("*.yaml")} == set(available_stages())
    assert {p.stem for p in (CONFIG_DIRECTORY / "budget").glob("*.yaml")} == set(BUDGETS)
    keys = [set(OmegaConf.load(CONFIG_DIRECTORY / "budget" / f"{name}.yaml")) for name in BUDGETS]
    assert keys[0] == keys[1] == keys[2]


def test_a_missing_package_of_a_stage_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    import pipeline.stages as stages

    def import_module(name: str) -> None:
        raise ModuleNotFoundError("No module named 'mujoco'", name="mujoco")

    monkeypatch.setattr(stages.importlib, "import_module", import_module)
    with pytest.raises(StageError, match="stage phantoms needs the module 'mujoco', which is not installed: run `make"):
        stages.load_stage("phantoms")


def test_a_stage_whose_input_was_damaged_stops_and_names_the_command_that_mends_it(pipeline_process) -> None:
    make = ("stage=phantoms", "stage.phantoms=[type_1]", "stage.picture=false", "stage.resolution_mm=2.5", "name=run")
    assert pipeline_process.run_here(*make).returncode == 0
    lumen = pipeline_process.runs / "run" / "phantoms" / "type_1" / "lumen.stl"
    content = bytearray(lumen.read_bytes())
    content[len(content) // 2] ^= 1
    lumen.write_bytes(content)
    done = pipeline_process.run_here("stage=expert", "name=run", "stage.phantoms=[type_1]", "stage.targets=[bca]")
    assert done.returncode == 2
    (line,) = done.stderr.strip().splitlines()
    assert f"stage expert cannot read stage phantoms: {lumen}" in line
    command = shlex.split(re.search(r"`python -m pipeline (.*)`", line)[1])
    assert {*make, "force=true"} <= set(command)
    mended = pipeline_process.run_here(*(word for word in command if not word.startswith(("runs_dir=", "force="))))
    assert mended.returncode == 0
    assert "so the stage runs again" in mended.stdout  # without force=true, too
    assert "up to date" in pipeline_process.run_here(*make).stdout


A_FOLDER, A_FILE = "folder", "file"
# What lies in the way, of which kind, and a word of the sentence; the stage is the report, which needs no input.
IN_THE_WAY = {
    "runs folder is a file": ("runs", A_FILE, "a file lies where a folder is needed"),
    "stage folder is a file": ("runs/desk/report", A_FILE, "a file lies where a folder is needed"),
    "manifest is a folder": ("runs/desk/report/manifest.json", A_FOLDER, "is a directory"),
    "log is a folder": ("runs/desk/.hydra/report/endonav.log", A_FOLDER, "is a directory"),
}
REFUSED_RUNS = {
    "/dev/null": "not a directory",
    "''": "runs_dir is empty: give a path",
    "a" * 300: "file name too long",
}


def ended(commands: list[list[str]]) -> list[tuple[list[str], int]]:
    """What each command line said, and its exit code."""
    answers = []
    for words in commands:
        told = io.StringIO()
        with process_kept(), contextlib.redirect_stdout(told), contextlib.redirect_stderr(told):
            code = main(words)
        answers.append((told.getvalue().splitlines(), code))
    return answers


def test_what_lies_in_the_way_is_one_sentence(tmp_path: Path) -> None:
    commands = []
    for number, (place, kind, _) in enumerate(IN_THE_WAY.values()):
        path = tmp_path / str(number) / place
        path.parent.mkdir(parents=True)
        path.mkdir() if kind is A_FOLDER else path.touch()
        commands.append(["stage=report", f"runs_dir={tmp_path / str(number) / 'runs'}"])
    for (lines, code), (_, _, words) in zip(ended(commands), IN_THE_WAY.values(), strict=True):
        assert code == 1, lines
        (sentence,) = [line for line in lines if not line.startswith("report: working")]
        assert sentence.startswith("the system refused ")
        assert words in sentence


def test_a_refused_run_leaves_no_record(tmp_path: Path) -> None:
    for number, place in enumerate(("report/.lock/x", "report/mine.txt", "report")):
        path = tmp_path / str(number) / "desk" / place
        path.parent.mkdir(parents=True)
        path.touch()
    commands = [["stage=report", f"runs_dir={tmp_path / str(number)}"] for number in range(3)]
    assert all(len(lines) == 1 and code for lines, code in ended(commands))
    assert not list(tmp_path.rglob(".hydra"))


def test_folders_that_cannot_be_made_are_one_sentence() -> None:
    commands = [["stage=report", f"runs_dir={runs}"] for runs in REFUSED_RUNS]
    for (lines, code), words in zip(ended(commands), REFUSED_RUNS.values(), strict=True):
        assert code in (1, 2), lines
        (sentence,) = lines
        assert words in sentence
        assert len(sentence) < 400


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (PermissionError(13, "Permission denied", "/x"), "/x (permission denied): change its permissions"),
        (OSError(24, "Too many open files"), "ulimit -n"),
        (FileNotFoundError(2, "No such file or directory", "/x"), "/x (no such file or directory): it is missing"),
        (OSError(5, "Input/output error", "/x"), "mend that and run the same command again"),
        (OSError(28, "No space left on device", "/x"), "no room left while writing /x"),
        (OSError("there are no pretrained weights"), "there are no pretrained weights"),
    ],
)
def test_what_the_system_refuses_says_what_to_do(error: OSError, words: str) -> None:
    assert words in one_line(error, [])
    wrapped = ValueError("Unable to configure handler 'file'")
    wrapped.__cause__ = error
    assert one_line(wrapped, []) == one_line(error, [])
