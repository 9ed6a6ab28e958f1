"""Installation checks and the Makefile's help."""

import re
import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest

from pipeline import installation
from pipeline.stages import available_stages
from pipeline.store.provenance import PROJECT_ROOT
from tests.integration.test_distributions import CUDA_DISTRIBUTIONS


@pytest.mark.parametrize("index", ["", "https://example.invalid/cpu"])
def test_an_index_for_torch_is_asked_for_torch_alone(index: str) -> None:
    command = ["make", "-n", "-W", "constraints.txt", "setup", *([f"TORCH_INDEX={index}"] if index else [])]
    shown = subprocess.run(command, cwd=PROJECT_ROOT, capture_output=True, text=True, check=True).stdout
    lines = [line for line in shown.splitlines() if "pip install" in line]
    of_torch = [line for line in lines if "--index-url" in line]
    assert len(of_torch) == bool(index)
    for line in of_torch:
        assert line.endswith("torch")
        assert "--no-deps" in line
        assert f'--index-url "{index}"' in line
        assert lines.index(line) < next(n for n, other in enumerate(lines) if "requirements.txt" in other)


def test_a_missing_compiler_and_an_old_python_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(installation.shutil, "which", lambda name: None)
    (sentence,) = installation.missing_for_build()
    assert "no C compiler found" in sentence
    monkeypatch.setattr(installation, "OLDEST_PYTHON", (99, 0))
    assert any("Python 99.0 or newer is needed" in sentence for sentence in installation.missing_for_build())


def test_a_full_disk_is_one_sentence_before_anything_is_installed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(installation.shutil, "disk_usage", lambda folder: SimpleNamespace(free=287_000_000))
    assert installation.main(["before", "--environment", str(tmp_path / "new")]) == 1
    assert "0.3 GB are free on this disk and 4 are needed" in capsys.readouterr().err
    assert installation.main(["before", "--environment", str(tmp_path)]) == 0  # one that is there needs little more


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
        (["all"], "--beside 2 all -- budget=desk name=desk pretrained=1"),
        (["all", "PRETRAINED=0", "BESIDE=1", "NAME=mine"], "--beside 1 all -- budget=desk name=mine pretrained=0"),
        (["all", "BUDGET=thesis"], "--beside 2 all -- budget=thesis name=thesis pretrained=0"),
        (["all", "ARGS=force=true"], "--beside 2 all -- budget=desk name=desk pretrained=1 force=true"),
        (["enn", "SEEDS=2"], "--seeds 2 --beside 2 --inputs enn -- budget=desk name=desk pretrained=0"),
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
    assert not [name for name in pins if name.startswith(CUDA_DISTRIBUTIONS)]
    assert {"torch", "mujoco", "numpy", "hydra-core", "pytest", "ruff", "setuptools"} <= set(pins)
