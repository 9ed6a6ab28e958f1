"""OpenCV with the project's number of threads: all others take `cv2` from here, and only when they need it.

OpenCV starts as many threads as there are cores, whatever OMP_NUM_THREADS says. Processes that share the cores set that
variable (the pipeline sets it to 1), so it counts here, too; OpenCV's own OPENCV_FOR_THREADS_NUM goes before it.
"""

from __future__ import annotations

import os

import cv2

__all__ = ["cv2"]


def _follow_environment() -> None:
    threads = os.environ.get("OMP_NUM_THREADS", "")
    if threads.isdecimal() and int(threads) and "OPENCV_FOR_THREADS_NUM" not in os.environ:
        cv2.setNumThreads(int(threads))


_follow_environment()
