"""What a cluster runs on the machine that it has chosen for a job: the job's process, watched to its end.

It needs the standard library alone, for a machine where nothing of the project can be imported: Ray sends it by value.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import time
from dataclasses import dataclass
from multiprocessing import Pipe
from typing import Any

WORKER = "pipeline.jobs.engines.cluster_worker"
MESSAGES, DRIVER = "messages.jsonl", "driver.json"
_SECONDS_BETWEEN_LOOKS = 1.0
_STOPPED = (0, -2, -10, -12, -15)  # exit codes of a process that left by itself, or that somebody asked to leave


@dataclass(frozen=True)
class Task:
    """A job that is sent out, as plain values."""

    place: str  # folder of this attempt, which all machines must see
    token: str  # of the driver
    lease_s: float  # that the job works on without a sign of its driver
    python: str  # the interpreter
    cwd: str  # the driver's working directory
    environment: dict[str, str]  # variables beside those of the machine
    order: bytes  # what the job's process is given


def run_task(task: Task) -> str | None:
    """Runs a job in a process that ends with this one, and waits for it; gives why it could not start, or None."""
    for path in (task.place, task.python, task.cwd):
        if not os.path.exists(path):
            return (
                f"machine {socket.gethostname()} does not see {path}: put the project, its environment and runs_dir "
                "on a file system that all machines share"
            )
    _write(task, "started")  # before the look: a new driver waits for every attempt that has started
    watch = _Watch(task)
    if (lost := watch.lost()) is None:
        ours, theirs = Pipe()
        with open(os.path.join(task.place, "output.txt"), "ab") as output:
            process = subprocess.Popen(
                [task.python, "-m", WORKER, str(theirs.fileno())],
                cwd=task.cwd, env={**os.environ, **task.environment}, pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL, stdout=output, stderr=output,
            )  # fmt: skip
        theirs.close()
        try:
            with contextlib.suppress(OSError):  # it has ended already, and its exit code says how
                ours.send_bytes(task.order)
            while process.poll() is None and (lost := watch.lost()) is None:
                if watch.stopping:
                    with contextlib.suppress(OSError):
                        ours.send("stop")
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(_SECONDS_BETWEEN_LOOKS)
        finally:
            process.kill()
            code = process.wait()
            ours.close()
    if lost is not None:
        _write(task, "lost", lost)
    elif code > 0:
        _write(task, "lost", f"the job's process ended with code {code}: see {task.place}/output.txt")
    else:
        _write(task, "ended", "" if code in _STOPPED else f"its process was killed by signal {-code}")
    return None


class _Watch:
    """Looks for the signs of a driver, which may be gone, and another at work."""

    def __init__(self, task: Task) -> None:
        self._task, self.stopping = task, False
        self._beat, self._since = -1, time.monotonic()

    def lost(self) -> str | None:
        """Why the job must end at once; None while it may work on."""
        place, lease_s = self._task.place, self._task.lease_s
        driver = read_driver(os.path.dirname(place))
        if driver.get("token", self._task.token) != self._task.token:
            return "another driver works in its folder"
        if os.path.basename(place) in driver.get("revoked", ()):
            return "its driver gave it to another machine"
        self.stopping = driver.get("stopping", False)
        if driver.get("beat", self._beat) != self._beat:
            self._beat, self._since = driver["beat"], time.monotonic()
        return f"no sign of its driver for {lease_s:.0f} s" if time.monotonic() - self._since > lease_s else None


def read_driver(folder: str) -> dict[str, Any]:
    """What a driver says of itself; nothing where its file is not there, or just being written."""
    with contextlib.suppress(OSError, ValueError), open(os.path.join(folder, DRIVER), encoding="utf-8") as file:
        content = json.load(file)
        return content if isinstance(content, dict) else {}
    return {}


def _write(task: Task, kind: str, text: str = "") -> None:
    write_line(task.place, {"kind": kind, "text": text})


def write_line(place: str, message: dict[str, Any]) -> None:
    """Appends a message to an attempt's file, at once."""
    with open(os.path.join(place, MESSAGES), "a", encoding="utf-8") as file:
        file.write(json.dumps(message) + "\n")
        file.flush()
        os.fsync(file.fileno())
