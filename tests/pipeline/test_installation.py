"""Installation checks and the Makefile's help."""

from __future__ import annotations

import re
import subprocess

import pytest

from pipeline import installation
from pipeline.stages import available_stages
from pipeline.store.provenance import PROJECT_ROOT


def test_cuda_and_torchvision_are_found() -> None:
    names = ["torch", "numpy", "nvidia-cublas-cu12", "triton", "TorchVision"]
    assert installation.unwanted_distributions(names, gpu=False) == ["nvidia-cublas-cu12", "torchvision", "triton"]
    assert installation.unwanted_distributions(names, gpu=True) == ["torchvision"]
    assert installation.unwanted_distributions(["torch", "numpy"], gpu=False) == []


def test_this_environment_is_clean() -> None:
    assert installation.main(["after"]) == 0


def test_a_missing_compiler_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(installation.shutil, "which", lambda name: None)
    (sentence,) = installation.missing_for_build()
    assert "no C compiler found" in sentence
    assert "apt-get install build-essential" in sentence


def test_an_old_python_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(installation, "OLDEST_PYTHON", (99, 0))
    assert any("Python 99.0 or newer is needed" in sentence for sentence in installation.missing_for_build())


def test_a_missing_gl_library_is_told_but_does_not_stop_the_installation(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(installation.ctypes.util, "find_library", lambda name: None)
    monkeypatch.setattr(installation, "install_gl", lambda: None)
    assert installation.gl_backend() is None
    assert installation.main(["before"]) == 0
    assert "apt-get install libegl1" in capsys.readouterr().err


def test_every_verb_of_the_makefile_is_explained() -> None:
    text = (PROJECT_ROOT / "Makefile").read_text()
    verbs = set(re.findall(r"^([^\s.#:=$]+):(?!=)", text, flags=re.MULTILINE))
    assert {"console", "thesis-check", "clean-all"} <= verbs
    shown = subprocess.run(["make", "help"], cwd=PROJECT_ROOT, capture_output=True, text=True, check=True).stdout
    explained = set(re.findall(r"^  (\S+) ", shown, flags=re.MULTILINE))
    assert explained == verbs | set(available_stages())


@pytest.mark.parametrize(
    ("words", "options"),
    [
        (["all"], "--beside 2 all -- budget=desk name=desk"),
        (["all", "SEEDS=3", "BUDGET=smoke"], "--seeds 3 --beside 2 all -- budget=smoke name=smoke"),
        (["all", "BESIDE=1", "NAME=mine"], "--beside 1 all -- budget=desk name=mine"),
        (["all", "ARGS=stage.device=cuda"], "--beside 2 all -- budget=desk name=desk stage.device=cuda"),
        (["enn", "SEEDS=2"], "--seeds 2 --beside 2 --inputs enn -- budget=desk name=desk"),
    ],
)
def test_verbs_pass_seeds_and_stages_beside_each_other_on(words: list[str], options: str) -> None:
    shown = subprocess.run(["make", "-n", *words], cwd=PROJECT_ROOT, capture_output=True, text=True, check=True).stdout
    (command,) = [line for line in shown.splitlines() if "pipeline.chain" in line]
    assert command.split("pipeline.chain ", 1)[1].split() == options.split()


def test_constraints_pin_every_requirement_exactly() -> None:
    lines = [line for line in (PROJECT_ROOT / "constraints.txt").read_text().splitlines() if not line.startswith("#")]
    assert all(re.fullmatch(r"[A-Za-z0-9_.-]+==[A-Za-z0-9.]+", line) for line in lines)
    pins = dict(line.lower().split("==") for line in lines)
    assert "torchvision" not in pins
    assert not [name for name in pins if name.startswith("nvidia")]
    assert {"torch", "mujoco", "numpy", "hydra-core", "pytest", "ruff", "setuptools"} <= set(pins)
