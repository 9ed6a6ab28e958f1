"""OpenCV's threads follow the variable by which the project limits threads."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({"OMP_NUM_THREADS": "1"}, 1),
        ({"OMP_NUM_THREADS": "3"}, 3),
        ({"OMP_NUM_THREADS": "3", "OPENCV_FOR_THREADS_NUM": "2"}, 2),
        ({"OMP_NUM_THREADS": "4,2"}, None),  # OpenMP's own form for nested loops: left to OpenCV
        ({}, None),
    ],
)
def test_threads_follow_the_environment(environment: dict[str, str], expected: int | None) -> None:
    kept = {name: value for name, value in os.environ.items() if not name.endswith(("NUM_THREADS", "THREADS_NUM"))}
    snippet = "import cv2; own = cv2.getNumThreads(); import guide3d.opencv; print(own, cv2.getNumThreads())"
    run = subprocess.run([sys.executable, "-c", snippet], env={**kept, **environment}, capture_output=True, check=True)
    own, followed = (int(word) for word in run.stdout.split())
    assert followed == (own if expected is None else expected)


def test_importing_the_package_loads_no_opencv() -> None:
    snippet = "import guide3d, sys; print('cv2' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", snippet], capture_output=True, check=True)
    assert run.stdout.strip() == b"False"


def test_all_take_opencv_from_where_its_threads_are_set() -> None:
    root = Path(__file__).resolve().parents[2]
    folders = [
        root / "pipeline",
        *(root / "packages" / name / "src" for name in ("cathsim", "guide3d", "splineformer")),
    ]
    direct = re.compile(r"^\s*(?:import cv2|from cv2 )", re.MULTILINE)
    files = [path for folder in folders for path in folder.rglob("*.py")]
    assert len(files) > 200
    found = {path.name for path in files if direct.search(path.read_text(encoding="utf-8"))}
    assert found == {"opencv.py"}
