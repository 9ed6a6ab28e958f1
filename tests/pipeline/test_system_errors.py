"""What the operating system refuses is one sentence and an exit code, never a traceback."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

import pytest

from pipeline.launch import main, one_line
from tests.conftest import process_kept

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
