"""Networks on a second device, in a process of their own: torch must know of it before anything else is learnt."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

pytestmark = pytest.mark.slow


def test_networks_train_and_are_read_on_a_second_device() -> None:
    files = [f"tests/{package}/on_second_device.py" for package in ("enn", "splineformer", "pipeline")]
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *files]
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=900, check=False)
    assert ran.returncode == 0, ran.stdout[-4000:] + ran.stderr[-2000:]
    assert " passed" in ran.stdout
