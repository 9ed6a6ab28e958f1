"""Trainings by several processes: torchrun, watched, stopped with the job, its error in one sentence."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence

from pipeline.jobs.worker import Report
from pipeline.store.errors import StageError

_SECONDS_BETWEEN_LOOKS = 1.0


def train_together(module: str, words: Sequence[str], processes: int, report: Report) -> None:
    """Starts torchrun and waits; stopping it leaves the last checkpoint.

    Args:
        module: run by every process, as by `python -m`.
        report: called while it runs; what it raises stops the processes.

    Raises:
        StageError: torchrun failed.
    """
    command = [
        sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(processes),
        "-m", module, *words,
    ]  # fmt: skip
    # a file, not a pipe: one that nobody reads while the processes run would fill and stop them
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as errors:
        running = subprocess.Popen(command, stderr=errors, env={**os.environ})
        try:
            while running.poll() is None:
                time.sleep(_SECONDS_BETWEEN_LOOKS)
                report(0.5, f"{processes} processes")
        finally:
            if running.poll() is None:
                running.terminate()
            running.wait()
        if running.returncode:
            errors.seek(0)
            lines = [line.strip() for line in errors if line.strip()]
            raise StageError(
                f"torchrun ended with code {running.returncode}: {lines[0] if lines else 'no word of why'}"
            )
