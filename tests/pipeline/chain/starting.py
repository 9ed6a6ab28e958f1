"""Starts chains as a terminal does."""

from __future__ import annotations

import signal
import subprocess
import sys

from tests.conftest import PipelineProcess


def start(pipeline_process: PipelineProcess, *arguments: str) -> subprocess.Popen[str]:
    """A chain in a process group of its own, which a test may interrupt."""
    return subprocess.Popen(
        [sys.executable, "-m", "pipeline.chain", *arguments, f"runs_dir={pipeline_process.runs}"],
        env=pipeline_process.environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
