"""Public names: what the tables of guide3d and its folders promise is there, and is what its module holds."""

from __future__ import annotations

import importlib
import subprocess
import sys

import pytest

PACKAGES = ("guide3d", "guide3d.calibration", "guide3d.dataset", "guide3d.dicom", "guide3d.reconstruction")


@pytest.mark.parametrize("package", PACKAGES)
def test_every_name_of_a_table_is_there(package: str) -> None:
    module = importlib.import_module(package)
    assert set(module._HOME) | {"__version__"} >= set(module.__all__) >= set(module._HOME)
    for name, home in module._HOME.items():
        assert getattr(module, name) is getattr(importlib.import_module(f"{package}.{home}"), name)
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = module.nothing


def test_a_name_is_never_hidden_by_a_module_of_that_name() -> None:
    """The import system binds a submodule to its package, over a lazy name that is the same."""
    for package in PACKAGES:
        module = importlib.import_module(package)
        for name in set(module._HOME) - {"read"}:
            assert importlib.util.find_spec(f"{package}.{name}") is None


def test_the_function_read_stays_one_when_its_command_is_imported() -> None:
    code = "import guide3d, guide3d.read as first; import guide3d.read; assert first is guide3d.read; print(first)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("<function read")


def test_the_calibration_runs_as_a_module() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "guide3d.calibration", "--help"], capture_output=True, text=True, check=True
    )
    assert "--output" in done.stdout
