"""Paths with signs of Hydra's grammar: they arrive as they were written, or the sentence shows how."""

import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir

from pipeline.config import CONFIG_DIRECTORY, register_schemas
from pipeline.launch import main
from pipeline.settings.quoting import chosen_value, quoted, unquoted, with_quoted_paths

NAMES = [
    "with space.stl", "[x],y'ü.stl", "a=b.stl", "{b}.stl", "a$x.stl", 'say"d.stl', "back\\slash.stl", "(1).stl",
    "per%d.stl", "co:lon.stl", "${oc.env:HOME}.stl", "hash#.stl", "\\'.stl", "~.stl", " [edge] ",
]  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_a_path_arrives_as_it_was_written(name: str, tmp_path: Path) -> None:
    (tmp_path / name).touch()
    words = with_quoted_paths(["stage=phantoms", f"phantom.file={tmp_path / name}"])
    register_schemas(["phantoms"])
    with initialize_config_dir(str(CONFIG_DIRECTORY), version_base="1.3"):
        assert compose("config", overrides=words).phantom.file == str(tmp_path / name)
    assert unquoted(quoted(name)) == name
    assert with_quoted_paths(words) == words, "what is quoted stays so"


def test_other_words_stay_as_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "enn").touch()
    monkeypatch.chdir(tmp_path)
    words = ["stage=enn", "-m", "seed=0,1", "stage.phantoms=[type_1]", "phantom.file='enn'", "runs_dir=${oc.env:X}"]
    assert with_quoted_paths(words) == words
    assert with_quoted_paths(["runs_dir=new [runs]"]) == ["runs_dir='new [runs]'"]
    monkeypatch.setenv("HOME", "/home/me")
    at_home = with_quoted_paths(["phantom.file=~/a b.stl", "runs_dir=~/runs"])
    assert at_home == ["phantom.file='/home/me/a b.stl'", "runs_dir='/home/me/runs'"]
    assert chosen_value(["runs_dir=~/runs"], "runs_dir", "runs") == "/home/me/runs"
    assert chosen_value(["runs_dir='new [runs]'"], "runs_dir", "runs") == "new [runs]"


def test_an_unreadable_text_is_shown_in_the_quotes_that_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stage=phantoms", "phantom.file=/nowhere/[x],y'ü.stl"]) == 2
    sentence = capsys.readouterr().err
    assert sentence.count("\n") == 1
    (shown,) = shlex.split(sentence.rpartition("in quotes: ")[2])
    assert main(["stage=phantoms", shown]) == 2
    assert capsys.readouterr().err.startswith("phantom.file=/nowhere/[x],y'ü.stl is no file: ")


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
@pytest.mark.parametrize("name", NAMES[:-1])  # make takes spaces off the edges
def test_make_passes_the_demo_any_path(name: str) -> None:
    """With a Python that shows what it was called with."""
    shown = subprocess.run(
        ["make", "demo", f"DEMO={name}", "PY=printf '<%s>'", "GL=", "--assume-old=setup"],
        cwd=CONFIG_DIRECTORY.parent, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert shown.stdout.endswith(f"<--anatomy={name}>")
