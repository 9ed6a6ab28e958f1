"""Files by which a driver and its jobs on other machines speak, over a folder that all of them share.

``.jobs/`` in a stage's folder holds

- ``driver.json``: which driver works here, and a number that grows every two seconds while it lives;
- ``<job>-<attempt>/``, for each time that a job was sent out: ``messages.jsonl``, what it reports, a line a message;
  ``stop`` or ``revoked``, written by the driver, which ask it to leave at its next report or end it at once; ``ended``,
  written last, when no process of it is left.

Files are opened for each look and written in place: file systems of clusters show others a file's content when it is
opened, but may remember for a minute what a folder holds.
"""

from __future__ import annotations

import json
import logging
import os
import threading
import time
import uuid
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pipeline.jobs.costs import Cost
from pipeline.jobs.worker import Message

JOBS = ".jobs"
MESSAGES, STOP, REVOKED, ENDED_FILE = "messages.jsonl", "stop", "revoked", "ended"
_SECONDS_BETWEEN_BEATS = 2.0
_SECONDS_BETWEEN_LOOKS = 0.5
_DRIVER = "driver.json"
_LONGEST_LEASE_S = 60.0  # where the earlier driver's file cannot be read

_LOGGER = logging.getLogger(__name__)


class Driver:
    """The sign of life of a stage's process, which its jobs look for."""

    def __init__(self, stage: Path, lease_s: float) -> None:
        """Args:
        stage: its folder.
        lease_s: that its jobs work on without one.
        """
        self.path, self.token, self._lease_s = stage / JOBS / _DRIVER, uuid.uuid4().hex, lease_s
        self._beats = 0
        self._ended = threading.Event()
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._beat()
        self._thread = threading.Thread(target=self._go_on, daemon=True)

    def start(self) -> Driver:
        """Gives signs of life from here on."""
        self._thread.start()
        return self

    def close(self) -> None:
        """Gives none any more."""
        self._ended.set()

    def _go_on(self) -> None:
        while not self._ended.wait(_SECONDS_BETWEEN_BEATS):
            try:
                self._beat()
            except OSError as error:  # e.g. a full disk: jobs end after a while, and are done again
                _LOGGER.warning("no sign of life could be written: %s", error)

    def _beat(self) -> None:
        self._beats += 1
        self.path.write_text(
            json.dumps({"token": self.token, "beat": self._beats, "lease_s": self._lease_s}), encoding="utf-8"
        )


class Lease:
    """Whether a job may work on: its driver lives, is the one that sent it out, and has not revoked it."""

    def __init__(self, attempt: Path, token: str, lease_s: float) -> None:
        """Args:
        attempt: the folder of this attempt.
        token: of the driver that sent it out.
        lease_s: that it works on without a sign of its driver, which then may be gone, and another at work.
        """
        self._attempt, self._token, self._lease_s = attempt, token, lease_s
        self._driver = attempt.parent / _DRIVER
        self._beat, self._since = -1, time.monotonic()

    def lost(self) -> str | None:
        """Why the job must end at once; None while it may work on."""
        if (self._attempt / REVOKED).exists():
            return "its driver gave it to another machine"
        found = _read(self._driver)
        if found is not None and found.get("token") != self._token:
            return "another driver works in its folder"
        beat = None if found is None else found.get("beat")
        if beat is not None and beat != self._beat:
            self._beat, self._since = beat, time.monotonic()
        if time.monotonic() - self._since > self._lease_s:
            return f"no sign of its driver for {self._lease_s:.0f} s"
        return None

    def asked_to_stop(self) -> bool:
        """Whether the job is to leave at its next report."""
        return (self._attempt / STOP).exists()


def _read(path: Path) -> dict[str, Any] | None:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):  # not there, or just being written
        return None
    return found if isinstance(found, dict) else None


class MessageWriter:
    """Appends messages to an attempt's file."""

    def __init__(self, attempt: Path) -> None:
        self._path = attempt / MESSAGES

    def write(self, message: Message) -> None:
        """Writes a line, at once."""
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(message)) + "\n")
            file.flush()
            os.fsync(file.fileno())


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
    lease_s = float((_read(jobs / _DRIVER) or {}).get("lease_s", _LONGEST_LEASE_S))
    Driver(stage, lease_s)  # before looking: a job that starts later sees that its token is another
    started = [path.parent for path in jobs.glob(f"*/{MESSAGES}")]
    alive = [attempt for attempt in started if not (attempt / ENDED_FILE).exists()]
    if not alive:
        return
    _LOGGER.info("waiting for %d jobs of an earlier run to end, %.0f s at the most", len(alive), lease_s)
    deadline = time.monotonic() + lease_s
    while time.monotonic() < deadline and not all((attempt / ENDED_FILE).exists() for attempt in alive):
        time.sleep(_SECONDS_BETWEEN_LOOKS)
    for attempt in alive:
        (attempt / ENDED_FILE).touch()
