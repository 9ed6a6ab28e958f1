"""Files by which a driver and its jobs on other machines speak, over a folder that all of them share.

``.jobs/`` in a stage's folder holds

- ``driver.json``: which driver works here, a number that grows every two seconds while it lives, whether its jobs are
  to leave at their next report, and which attempts are to end at once;
- ``<job>-<attempt>/messages.jsonl``, for each time that a job was sent out: what it reports, a line a message, the last
  one when no process of it is left.

Files are opened for each look and written in place: file systems of clusters show others a file's content when it is
opened, but may remember for a minute what a folder holds.
"""

from __future__ import annotations

import json
import logging
import threading
import time
import uuid
from pathlib import Path
from typing import Any

from pipeline.jobs.engines.task import DRIVER, MESSAGES, read_driver
from pipeline.jobs.worker import ENDED, LOST, Message
from pipeline.store.costs import Cost

JOBS = ".jobs"
_SECONDS_BETWEEN_BEATS = 2.0
_SECONDS_BETWEEN_LOOKS = 0.5
_LONGEST_LEASE_S = 60.0  # where the earlier driver's file cannot be read

_LOGGER = logging.getLogger(__name__)


class Driver:
    """The sign of life of a stage's process, which its jobs look for."""

    def __init__(self, stage: Path, lease_s: float) -> None:
        """Args:
        stage: its folder.
        lease_s: that its jobs work on without one.
        """
        self.folder, self.token = stage / JOBS, uuid.uuid4().hex
        self._revoked: list[str] = []
        self._says: dict[str, Any] = {
            "token": self.token,
            "lease_s": lease_s,
            "beat": 0,
            "stopping": False,
            "revoked": self._revoked,
        }
        self._ended, self._gate = threading.Event(), threading.Lock()
        self.folder.mkdir(parents=True, exist_ok=True)
        self._beat()

    def start(self) -> Driver:
        """Gives signs of life from here on."""
        threading.Thread(target=self._go_on, daemon=True).start()
        return self

    def close(self) -> None:
        """Gives none any more."""
        self._ended.set()

    def stop(self) -> None:
        """Asks all jobs to leave at their next report."""
        self._says["stopping"] = True
        self._beat()

    def revoke(self, place: Path) -> None:
        """Has an attempt end at once."""
        self._revoked.append(place.name)
        self._beat()

    def _go_on(self) -> None:
        while not self._ended.wait(_SECONDS_BETWEEN_BEATS):
            self._beat()

    def _beat(self) -> None:
        with self._gate:
            self._says["beat"] += 1
            try:
                (self.folder / DRIVER).write_text(json.dumps(self._says), encoding="utf-8")
            except OSError as error:  # e.g. a full disk: jobs end after a while, and are done again
                _LOGGER.warning("no sign of life could be written: %s", error)


class MessageReader:
    """Reads the messages of an attempt as they come."""

    def __init__(self, attempt: Path) -> None:
        self._path, self._offset = attempt / MESSAGES, 0

    def new(self) -> list[Message]:
        """Messages since the last call; a line that is not whole yet comes with a later one."""
        try:
            with self._path.open("rb") as file:
                file.seek(self._offset)
                text = file.read()
        except FileNotFoundError:
            return []
        whole = text[: text.rfind(b"\n") + 1]
        self._offset += len(whole)
        return [_message(json.loads(line)) for line in whole.splitlines()]


def _message(values: dict[str, Any]) -> Message:
    cost = values.pop("cost", None)
    return Message(**values, cost=None if cost is None else Cost(**cost))


def end_earlier_jobs(stage: Path) -> None:
    """Waits until no job works in a stage's folder that a driver sent out which is gone; call it holding the lock.

    Those that live see that there is another driver and end at once; a machine that was lost is waited for as long as a
    job works on without a sign of its driver.

    Args:
        stage: the folder.
    """
    jobs = stage / JOBS
    if not jobs.is_dir():
        return
    lease_s = float(read_driver(str(jobs)).get("lease_s", _LONGEST_LEASE_S))
    Driver(stage, lease_s)  # before looking: a job that starts later sees that its token is another
    alive = {path.parent: MessageReader(path.parent) for path in jobs.glob(f"*/{MESSAGES}")}
    deadline, told = time.monotonic() + lease_s, False
    while True:
        for place, reader in list(alive.items()):
            if any(message.kind in (ENDED, LOST) for message in reader.new()):
                del alive[place]
        if not alive or time.monotonic() >= deadline:
            break
        if not told:
            told = True
            _LOGGER.info("waiting for %d jobs of an earlier run to end, %.0f s at the most", len(alive), lease_s)
        time.sleep(_SECONDS_BETWEEN_LOOKS)
    for place in alive:
        (place / MESSAGES).unlink()  # they are waited for once
