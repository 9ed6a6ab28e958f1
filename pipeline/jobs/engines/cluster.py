"""The engine of a cluster: sends jobs out, reads what they report in a shared folder, sends lost ones again.

A job that has failed by itself is not sent again. One whose machine was lost is, as often as the setting says, once it
is certain that nothing of it runs any more: its task has said so, or has had no sign of life for as long as it would
work on by itself. ``.jobs/`` in a stage's folder holds

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
import os
import pickle
import shutil
import sys
import threading
import time
import uuid
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.jobs.engines.local import ONE_THREAD
from pipeline.jobs.engines.settings import JOBS, ClusterSettings
from pipeline.jobs.engines.task import DRIVER, MESSAGES, Task, read_driver
from pipeline.jobs.machine import AUTO, CPU
from pipeline.jobs.worker import AGAIN, ENDED, LOST, STARTED, Job, Message
from pipeline.store.costs import Cost
from pipeline.store.errors import StageError
from pipeline.store.finished_items import safe_name
from pipeline.store.run_folder import RunFolder

_SECONDS_BETWEEN_BEATS = 2.0
_SECONDS_BETWEEN_LOOKS = 0.5
_LONGEST_LEASE_S = 60.0  # where the earlier driver's file cannot be read

_LOGGER = logging.getLogger(__name__)


class Driver:
    """The sign of life of a stage's process, which its jobs look for."""

    def __init__(self, stage: Path, lease_s: float) -> None:
        """For a stage's folder, whose jobs work on without a sign for `lease_s`."""
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
    """
    jobs = stage / JOBS
    lease_s = float(read_driver(str(jobs)).get("lease_s", _LONGEST_LEASE_S))
    Driver(stage, lease_s)  # before looking: a job that starts later sees that its token is another
    alive = {path.parent: MessageReader(path.parent) for path in jobs.glob(f"*/{MESSAGES}")}
    deadline, warned = time.monotonic() + lease_s, False
    while True:
        for place, reader in list(alive.items()):
            if any(message.kind in (ENDED, LOST) for message in reader.new()):
                del alive[place]
        if not alive or time.monotonic() >= deadline:
            break
        if not warned:
            warned = True
            _LOGGER.info("waiting for %d jobs of an earlier run to end, %.0f s at the most", len(alive), lease_s)
        time.sleep(_SECONDS_BETWEEN_LOOKS)
    for place in alive:
        (place / MESSAGES).unlink()  # they are waited for once


_SECONDS_FOR_LAST_WORDS = 5.0  # until what a job wrote can be seen here, after its scheduler says that it has ended
_STOPPED = "it was stopped"
# Variables that jobs are given beside those of their machine.
_CARRIED = ("CATHSIM_", "ENDONAV_FILMS", "ENN_LOGGER", "MUJOCO_GL", "PYTHONPATH", "WANDB_", "XDG_CACHE_HOME")


@dataclass(frozen=True)
class Needs:
    """What a job needs of a machine, beside one CPU."""

    gpus: int  # 0 or 1
    memory_gb: float

    def __str__(self) -> str:
        """For example ``1 CPU, 1 GPU and 4.0 GB of memory``."""
        return f"1 CPU{', 1 GPU' if self.gpus else ''} and {self.memory_gb:.1f} GB of memory"


class Executor(ABC):
    """A cluster's scheduler: runs tasks on machines that share a folder."""

    capacity: int  # jobs beside each other, for the estimate of the end
    has_gpus: bool  # for stage.device=auto

    def fits(self, needs: Needs) -> bool:
        """Whether a machine is large enough; by default the scheduler itself refuses what is not."""
        return True

    @abstractmethod
    def submit(self, name: str, task: Task, needs: Needs) -> Any:
        """Queues `run_task` of a task; gives the handle that the other methods are given."""

    @abstractmethod
    def result(self, handle: Any) -> str | None:
        """None while a task waits or runs; "": it has ended by itself; otherwise why it has not."""

    @abstractmethod
    def cancel(self, handle: Any) -> None:
        """Takes a task out of the queue, or ends it."""

    @abstractmethod
    def close(self) -> None:
        """Lets go of the cluster."""


@dataclass
class _Attempt:
    """A job that was sent out."""

    job: Job
    number: int
    place: Path
    handle: Any
    reader: MessageReader
    started: bool = False
    answered: bool = False
    ended_at: float | None = None  # when its scheduler said so
    again_at: float | None = None  # it is lost: when it is sent again at the latest


class ClusterEngine:
    """Jobs on the machines of a cluster."""

    def __init__(
        self, folder: RunFolder, executor: Executor, settings: ClusterSettings, *, device: str = CPU, at_once: int = 0
    ) -> None:
        """For the folder of a stage, which this process has locked; `at_once`: jobs in the queue, 0: no limit."""
        if ":" in device:
            executor.close()
            raise StageError(f"stage.device={device} names a GPU of one machine: on a cluster take cuda, auto or cpu")
        self._folder, self._executor, self._settings = folder, executor, settings
        self._on_gpus = device != CPU and (device != AUTO or executor.has_gpus)
        self._at_once = at_once
        self.capacity = min(at_once or executor.capacity, executor.capacity)
        self._attempts: dict[str, _Attempt] = {}
        self._messages: list[tuple[str, Message]] = []
        self._stopping, self._looked = False, float("-inf")
        self._driver = Driver(folder.path.absolute(), settings.lease_s).start()
        for old in self._driver.folder.iterdir():  # of earlier runs, which have ended
            if old.is_dir():
                shutil.rmtree(old, ignore_errors=True)

    def check(self, job: Job) -> None:
        """Refuses a job for which no machine is large enough."""
        if not self._executor.fits(self._needs(job)):
            raise StageError(
                f"{job.key} needs {self._needs(job)}, and no machine of the cluster has so much: add one, or lower "
                "engine.memory_gb or the stage's sizes"
            )

    def _needs(self, job: Job) -> Needs:
        return Needs(int(self._on_gpus and job.gpu_gb > 0), max(job.memory_gb, self._settings.memory_gb))

    def submit(self, job: Job) -> bool:
        """Queues a job; the cluster starts it when it has room."""
        if self._at_once and len(self._attempts) >= self._at_once:
            return False
        self._send(job, 1)
        return True

    def _send(self, job: Job, number: int) -> None:
        place = self._driver.folder / f"{safe_name(job.key)}-{self._driver.token[:8]}-{number}"
        place.mkdir()
        needs = self._needs(job)
        carried = {name: value for name, value in os.environ.items() if name.startswith(_CARRIED)}
        task = Task(
            place=str(place), token=self._driver.token, lease_s=self._settings.lease_s,
            python=sys.executable, cwd=os.getcwd(), environment={**carried, **ONE_THREAD},
            order=pickle.dumps((str(place), needs.gpus > 0, pickle.dumps((job.run, job.given)))),
        )  # fmt: skip
        handle = self._executor.submit(f"{self._folder.path.name} {job.key}", task, needs)
        self._attempts[job.key] = _Attempt(job, number, place, handle, MessageReader(place))

    def listen(self, timeout_s: float) -> list[tuple[str, Message]]:
        """Reads what has come in the shared folder."""
        time.sleep(max(min(timeout_s, self._looked + _SECONDS_BETWEEN_LOOKS - time.monotonic()), 0.0))
        if time.monotonic() - self._looked >= _SECONDS_BETWEEN_LOOKS:
            self._looked = time.monotonic()
            for attempt in list(self._attempts.values()):
                self._look_at(attempt)
        messages, self._messages = self._messages, []
        return messages

    def _look_at(self, attempt: _Attempt) -> None:
        result = self._executor.result(attempt.handle)  # before reading: what it wrote is read now or at a later look
        messages, now = attempt.reader.new(), time.monotonic()
        last = next((message for message in messages if message.kind in (ENDED, LOST)), None)
        if attempt.again_at is not None:
            if last is not None or now >= attempt.again_at:
                self._send(attempt.job, attempt.number + 1)
            return
        for message in messages:
            if message is not last:
                attempt.started = attempt.started or message.kind == STARTED
                attempt.answered = attempt.answered or message.kind in ("done", "failed")
                self._messages.append((attempt.job.key, message))
        if last is not None:
            if last.kind == ENDED and last.text:
                self._end(attempt, last.text)
            else:
                self._lost(attempt, last.text or "it was stopped on its machine", nothing_runs=True)
        elif result is not None:
            attempt.ended_at = now if attempt.ended_at is None else attempt.ended_at
            if now - attempt.ended_at >= _SECONDS_FOR_LAST_WORDS:
                self._lost(attempt, result or f"it ended without a word, see {attempt.place}")

    def _end(self, attempt: _Attempt, how: str) -> None:
        del self._attempts[attempt.job.key]
        self._messages.append((attempt.job.key, Message(ENDED, how)))

    def _lost(self, attempt: _Attempt, why: str, *, nothing_runs: bool = False) -> None:
        """Sends a job again whose machine is gone, or gives it up."""
        if attempt.answered or self._stopping:
            self._end(attempt, _STOPPED)
        elif attempt.number > self._settings.retries:
            self._end(attempt, f"it was lost {attempt.number} times, at last because {why}")
        else:
            attempt.again_at = time.monotonic() + (0.0 if nothing_runs else self._settings.lease_s)
            self._drop(attempt)
            text = f"lost ({why}); it is done again, time {attempt.number + 1} of {self._settings.retries + 1}"
            self._messages.append((attempt.job.key, Message(AGAIN, text)))

    def stop(self) -> None:
        """Asks the jobs under way to stop, and takes the others out of the queue."""
        self._stopping = True
        for attempt in list(self._attempts.values()):
            if not attempt.started or attempt.again_at is not None:
                self._drop(attempt)
                self._end(attempt, _STOPPED)
        self._driver.stop()

    def close(self) -> None:
        """Ends what is left."""
        for attempt in self._attempts.values():
            self._drop(attempt)
        self._attempts = {}
        self._driver.close()
        self._executor.close()

    def _drop(self, attempt: _Attempt) -> None:
        self._driver.revoke(attempt.place)
        self._executor.cancel(attempt.handle)
