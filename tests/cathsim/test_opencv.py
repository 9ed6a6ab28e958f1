"""OpenCV's threads follow the variable by which the project limits threads."""

from __future__ import annotations

import os
import subprocess
import sys

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
    snippet = "import cv2; own = cv2.getNumThreads(); import cathsim.opencv; print(own, cv2.getNumThreads())"
    run = subprocess.run([sys.executable, "-c", snippet], env={**kept, **environment}, capture_output=True, check=True)
    own, followed = (int(word) for word in run.stdout.split())
    assert followed == (own if expected is None else expected)
