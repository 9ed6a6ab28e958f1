"""`python -m PACKAGE` lists the command lines that the package has, a line each."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.integration.documents.pages import PACKAGES, PROJECT_ROOT

PROGRAM = re.compile("^if __name__ == ", re.MULTILINE)
INSIDE = {"cathsim.console.expert"}  # which the console starts


def programs(package: str) -> set[str]:
    """The package's modules that do something when they are run."""
    root = PROJECT_ROOT / "packages" / package / "src"
    files = [file for file in root.rglob("*.py") if PROGRAM.search(file.read_text(encoding="utf-8"))]
    names = {".".join(file.relative_to(root).with_suffix("").parts).removesuffix(".__main__") for file in files}
    return names - INSIDE - {package}


def run(package: str, cwd: Path, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", package, *words]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_lists_its_commands_without_torch(package: str, tmp_path: Path) -> None:
    (tmp_path / "torch.py").write_text("raise ModuleNotFoundError")  # stands in its way
    done = run(package, tmp_path)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    listed = [line.removeprefix("python -m ").split(":")[0] for line in lines if line.startswith("python -m ")]
    assert len(listed) == len(set(listed))
    assert set(listed) == programs(package)
    assert all(len(line.split(": ", 1)[1]) > 20 for line in lines if line.startswith("python -m "))


def test_a_word_too_many_is_wrong_usage(tmp_path: Path) -> None:
    assert run("guide3d", tmp_path, "moon").returncode == 2


@pytest.mark.parametrize(
    ("command", "unbuffered"),
    [
        ("enn", ""),
        ("guide3d", ""),
        ("cathsim.devices", ""),
        ("cathsim.devices", "1"),
        ("guide3d.read --help", "1"),
        ("pipeline.episodes --help", "1"),
    ],
)
def test_a_reader_that_has_gone_is_no_fault(command: str, unbuffered: str) -> None:
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "wb") as gone:
        words, own = [sys.executable, "-m", *command.split()], os.environ | {"PYTHONUNBUFFERED": unbuffered}
        done = subprocess.run(words, stdout=gone, stderr=subprocess.PIPE, check=False, env=own)
    assert (done.returncode, done.stderr) == (0, b"")


def test_a_training_without_torch_ends_with_one_line(run_python: Callable[[str], str]) -> None:
    trainings = ["guide3d.train", "guide3d.train_reader", "splineformer.train", "splineformer.train_on_fluoroscopy"]
    snippet = f"""
import json, runpy, sys
sys.modules['torch'], said = None, []
for command in {trainings}:
    sys.argv = [command, '--help']
    try:
        runpy.run_module(command, run_name='__main__', alter_sys=True)
    except SystemExit as end:
        said.append(end.code)
print(json.dumps(said))
"""
    wanted = "this part of guide3d needs torch: pip install 'endonav-guide3d[learning]'"
    assert json.loads(run_python(snippet)) == [f"{command}: {wanted}" for command in trainings]
