"""Commands of guide3d that have the name of a function, or of a folder."""

from __future__ import annotations

import subprocess
import sys


def test_the_function_read_stays_one_when_its_command_is_imported() -> None:
    code = "import guide3d, guide3d.read as first; import guide3d.read; assert first is guide3d.read; print(first)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("<function read")


def test_the_calibration_runs_as_a_module() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "guide3d.calibration", "--help"], capture_output=True, text=True, check=True
    )
    assert "--output" in done.stdout
