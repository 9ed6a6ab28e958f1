"""The process of a job on a machine of a cluster: ``python -m pipeline.jobs.engines.cluster_worker FD``.

The job comes over the connection FD, whose end means that its task is gone; what it reports goes to a file.
"""

from __future__ import annotations

import os
import pickle
import sys
import time
import traceback
from dataclasses import asdict
from multiprocessing.connection import Connection
from typing import Any

from pipeline.jobs.engines.task import write_line
from pipeline.jobs.machine import VISIBLE
from pipeline.jobs.worker import LOST, Message, work

_SECONDS_BETWEEN_PROGRESS = 2.0


class _Channel:
    """Sends to a file, receives from the task."""

    def __init__(self, place: str, task: Connection) -> None:
        self._place, self._task, self._last = place, task, float("-inf")
        self.close = task.close

    @property
    def closed(self) -> bool:
        """Whether this process has closed it."""
        return self._task.closed

    def recv(self) -> Any:
        """Waits for a word of the task, and writes that it is gone."""
        try:
            return self._task.recv()
        except (EOFError, OSError):
            if not self.closed:
                write_line(self._place, asdict(Message(LOST, "what started it is gone")))
            raise

    def send(self, message: Message) -> None:
        """Writes a message; progress only now and then."""
        now = time.monotonic()
        if message.kind == "progress":
            if now - self._last < _SECONDS_BETWEEN_PROGRESS:
                return
            self._last = now
        write_line(self._place, asdict(message))


def main(descriptor: int) -> None:
    """Takes the job and does it."""
    task = Connection(descriptor)
    place, on_gpus, job = pickle.loads(task.recv_bytes())
    channel: Any = _Channel(place, task)
    try:
        run, settings = pickle.loads(job)
    except Exception as error:  # a module that this machine cannot import
        channel.send(Message("failed", f"{type(error).__name__}: {error}", traceback=traceback.format_exc()))
        return
    work(run, settings, channel, tuple(filter(None, os.environ.get(VISIBLE, "0").split(","))) if on_gpus else ())


if __name__ == "__main__":
    main(int(sys.argv[1]))
