"""Waiting for what another process does."""

import subprocess
import time
from collections.abc import Callable


def wait_until(ready: Callable[[], object], process: subprocess.Popen[str] | None = None, seconds: float = 120) -> None:
    """Returns as soon as it is so; fails where a process ends before, or the time is over."""
    deadline = time.monotonic() + seconds
    while not ready():
        if process is not None:
            assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline, "it takes too long"
        time.sleep(0.005)
