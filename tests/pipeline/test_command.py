"""The command `endonav`: each word goes to what it names, and wrong ones are one sentence."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from pipeline import command
from pipeline.store.provenance import PROJECT_ROOT


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
    assert capsys.readouterr().err == (
        "endonav has no command 'stage': choose from stages, chain, episodes, models, demo, list, import, read, train, "
        "new, evaluate, data, console, info\n"
    )


def test_stages_and_chain_without_arguments_list_the_stages(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["stages"]) == 0
    assert "phantoms" in capsys.readouterr().out
    assert command.main(["chain"]) == 0
    assert "--inputs" in capsys.readouterr().out


def test_episodes_are_looked_at(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["episodes", "info", "nothing.mcap"]) == 2
    assert "nothing.mcap is no file" in capsys.readouterr().err


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
    assert command.main(["read", "nothing.png"]) == 1
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


@pytest.mark.parametrize("kind", ["policy", "phantom"])
def test_a_new_policy_and_a_new_phantom_pass_their_tests(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert command.main(["new", kind, "mine"]) == 0
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "test_mine.py"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout
    assert "2 passed" in done.stdout
    written = (tmp_path / "mine.py").read_bytes()
    for name, sentence in (("mine", "is there already"), ("3d", "is no Python name"), ("class", "is no Python name")):
        with pytest.raises(SystemExit) as ended:
            command.main(["new", kind, name])
        assert ended.value.code == 2
        assert sentence in capsys.readouterr().err
    assert (tmp_path / "mine.py").read_bytes() == written


def test_models_are_listed_and_have_cards(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["models"]) == 0
    assert "guide3d reader: Finds guidewires" in capsys.readouterr().out
    assert command.main(["models", "reader"]) == 0
    assert capsys.readouterr().out.startswith("#")
    assert command.main(["models", "nothing"]) == 2
    assert "there is no model 'nothing': choose from " in capsys.readouterr().err
    assert command.main(["models", "--help"]) == 0
    assert capsys.readouterr().out.startswith("endonav models [NAME]: ")


@pytest.mark.parametrize(
    "words", [["episodes", "moon"], ["episodes", "info"], ["demo", "--seed", "5000"], ["demo", "x"]]
)
def test_wrong_arguments_are_one_line(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        command.main(words)
    assert caught.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_stage_is_told_in_one_whole_line() -> None:
    for file in (PROJECT_ROOT / "conf" / "stage").glob("*.yaml"):
        first, second = file.read_text().splitlines()[:2]
        assert first.startswith("# "), file
        assert first.endswith("."), f"the help shows the first line of {file} alone"
        assert not second.startswith("#"), file


def test_the_demonstration_takes_its_own_arguments(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["demo", "--anatomy", "nowhere.stl", "--model", "generalist"]) == 2
    assert "there is no anatomy nowhere.stl" in capsys.readouterr().err


def test_a_missing_package_is_one_sentence(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def missing(arguments: list[str]) -> int:
        raise ModuleNotFoundError("No module named 'uvicorn'", name="uvicorn")

    monkeypatch.setitem(command._COMMANDS, "console", missing)
    assert command.main(["console"]) == 2
    assert "endonav console needs the module uvicorn" in capsys.readouterr().err


def test_a_message_that_says_what_to_install_is_kept(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def missing(arguments: list[str]) -> int:
        raise ModuleNotFoundError("pictures need matplotlib: pip install 'x[pictures]'", name="matplotlib")

    monkeypatch.setitem(command._COMMANDS, "console", missing)
    assert command.main(["console"]) == 2
    assert capsys.readouterr().err == "endonav console: pictures need matplotlib: pip install 'x[pictures]'\n"


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
    "words",
    [
        ["stages"],
        ["chain"],
        ["episodes", "--help"],
        ["demo", "--help"],
        ["console", "--help"],
        ["stages", "stage=navigation", "budget=smoke"],
    ],
    ids=" ".join,
)
def test_texts_of_the_command_name_it_and_nothing_of_a_clone(words: list[str], tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "pipeline.command", *words], cwd=tmp_path, capture_output=True, text=True, timeout=120,
        check=False,
    )  # fmt: skip
    said = done.stdout + done.stderr
    assert f"endonav {'chain' if 'stage=navigation' in words else words[0]}" in said
    assert not re.search(r"python -m pipeline|\bmake (setup|all|demo|ray)\b|\.venv", said), said
