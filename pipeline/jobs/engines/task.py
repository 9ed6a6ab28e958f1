"""What a cluster runs on the machine that it has chosen for a job: the job, which reports in a shared folder.

Until it imports the job's modules it needs the standard library alone: Ray sends it by value, so that a machine where
nothing of the project can be imported says so in its own words.
"""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import socket
import sys
import time
from dataclasses import asdict, dataclass
from typing import Any

MESSAGES, DRIVER = "messages.jsonl", "driver.json"
_SECONDS_BETWEEN_LOOKS = 1.0
_SECONDS_BETWEEN_PROGRESS = 2.0


@dataclass(frozen=True)
class Task:
    """A job that is sent out, as plain values."""

    place: str  # folder of this attempt, which all machines must see
    cwd: str  # the driver's working directory
    path: tuple[str, ...]  # where the driver finds modules
    environment: dict[str, str]  # variables beside those of the machine
    on_gpus: bool
    order: bytes  # the job's function and what it is given, pickled


def run_task(task: Task) -> str | None:
    """Runs a job in this process, which is its own; gives why it could not start, or None."""
    for path in (task.place, task.cwd):
        if not os.path.exists(path):
            return (
                f"machine {socket.gethostname()} does not see {path}: put the project, its environment and runs_dir "
                "on a file system that all machines share"
            )
    write_line(task.place, {"kind": "started"})
    os.environ.update(task.environment)
    os.chdir(task.cwd)
    sys.path[:] = dict.fromkeys([*task.path, *sys.path])
    run, given = pickle.loads(task.order)
    from pipeline.jobs.worker import work

    channel: Any = _Channel(task)
    gpus = tuple(filter(None, os.environ.get("CUDA_VISIBLE_DEVICES", "0").split(","))) if task.on_gpus else ()
    work(run, given, channel, gpus)
    write_line(task.place, {"kind": "ended"})
    return None


class _Channel:
    """A job's connection to its stage: sends to the attempt's file, receives by looking at the driver's."""

    def __init__(self, task: Task) -> None:
        self.closed = False
        self._task, self._told = task, float("-inf")

    def send(self, message: Any) -> None:
        """Writes a message; progress only now and then."""
        now = time.monotonic()
        if message.kind == "progress":
            if now - self._told < _SECONDS_BETWEEN_PROGRESS:
                return
            self._told = now
        write_line(self._task.place, asdict(message))

    def recv(self) -> None:
        """Waits until the driver asks to stop; an EOFError where the job must end at once."""
        while not self.closed:
            time.sleep(_SECONDS_BETWEEN_LOOKS)
            folder, name = os.path.split(self._task.place)
            driver = read_driver(folder)
            if name not in driver.get("attempts", [name]) and not self.closed:
                write_line(self._task.place, {"kind": "lost", "text": "no driver waits for it any more"})
                break
            if driver.get("stopping"):
                return
        raise EOFError

    def close(self) -> None:
        """The job has ended."""
        self.closed = True


def read_driver(folder: str) -> dict[str, Any]:
    """What a driver says of itself; nothing where its file is not there, or just being written."""
    with contextlib.suppress(OSError, ValueError), open(os.path.join(folder, DRIVER), encoding="utf-8") as file:
        content = json.load(file)
        return content if isinstance(content, dict) else {}
    return {}


def write_line(place: str, message: dict[str, Any]) -> None:
    """Appends a message to an attempt's file, at once."""
    with open(os.path.join(place, MESSAGES), "a", encoding="utf-8") as file:
        file.write(json.dumps(message) + "\n")
        file.flush()
        os.fsync(file.fileno())
