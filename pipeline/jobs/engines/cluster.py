"""The engine of a cluster: sends jobs out, reads what they report in a shared folder, sends lost ones again.

A job that has raised an error is not sent again. One whose process or machine was lost is, as often as the setting
says. ``.jobs/`` in a stage's folder holds

- ``driver.json``: which attempts may work, all others end at once; and whether they are to leave at their next report;
- ``<job>-<attempt>/messages.jsonl``, for each time that a job was sent out: what it reports, a line a message.

Files are opened for each look and written in place: file systems of clusters show others a file's content when it is
opened, but may remember for a minute what a folder holds.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import pickle
import shutil
import sys
import time
import uuid
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.jobs.engines.local import ONE_THREAD, variables_set
from pipeline.jobs.engines.settings import JOBS, ClusterSettings
from pipeline.jobs.engines.task import DRIVER, MESSAGES, Task
from pipeline.jobs.machine import AUTO, CPU
from pipeline.jobs.worker import AGAIN, ENDED, LOST, STARTED, Job, Message
from pipeline.store.costs import Cost
from pipeline.store.errors import StageError
from pipeline.store.finished_items import safe_name
from pipeline.store.run_folder import RunFolder

_SECONDS_BETWEEN_LOOKS = 0.5
SECONDS_TO_END = 60.0  # that jobs of an earlier driver are waited for

_LOGGER = logging.getLogger(__name__)


class Driver:
    """What a stage's process says to its jobs, which look for it."""

    def __init__(self, stage: Path) -> None:
        """For a stage's folder; jobs of an earlier driver end."""
        self.folder = stage / JOBS
        self._attempts: list[str] = []
        self._says = {"stopping": False, "attempts": self._attempts}
        self.folder.mkdir(parents=True, exist_ok=True)
        self._tell()

    def stop(self) -> None:
        """Asks all jobs to leave at their next report."""
        self._says["stopping"] = True
        self._tell()

    def admit(self, place: Path) -> None:
        """Lets an attempt work."""
        self._attempts.append(place.name)
        self._tell()

    def dismiss(self, place: Path) -> None:
        """Has an attempt end at once."""
        if place.name in self._attempts:
            self._attempts.remove(place.name)
            self._tell()

    def _tell(self) -> None:
        (self.folder / DRIVER).write_text(json.dumps(self._says), encoding="utf-8")


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

    Those that live see that the driver does not know them and end at once; a machine that was lost is waited for once.
    """
    jobs = Driver(stage).folder
    alive = {path.parent: MessageReader(path.parent) for path in jobs.glob(f"*/{MESSAGES}")}
    deadline = time.monotonic() + SECONDS_TO_END
    _LOGGER.info("waiting for jobs of an earlier run to end, %.0f s at the most", SECONDS_TO_END)
    while True:
        for place, reader in list(alive.items()):
            if any(message.kind in (ENDED, LOST) for message in reader.new()):
                del alive[place]
        if not alive or time.monotonic() >= deadline:
            break
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
        """Takes a task out of the queue, or ends it; one that has ended is left alone."""

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
        self._attempts: dict[str, _Attempt] = {}
        self._messages: list[tuple[str, Message]] = []
        self._environment = contextlib.ExitStack()  # of jobs that inherit this process's
        self._environment.enter_context(variables_set(ONE_THREAD))
        self._stopping, self._looked = False, float("-inf")
        self._driver = Driver(folder.path.absolute())
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
        place = self._driver.folder / f"{safe_name(job.key)}-{uuid.uuid4().hex[:8]}-{number}"
        place.mkdir()
        self._driver.admit(place)
        needs = self._needs(job)
        carried = {name: value for name, value in os.environ.items() if name.startswith(_CARRIED)}
        task = Task(
            place=str(place), cwd=os.getcwd(), path=tuple(sys.path),
            environment={**carried, **ONE_THREAD}, on_gpus=needs.gpus > 0, order=pickle.dumps((job.run, job.given)),
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
        for message in messages:
            if message is not last:
                attempt.started = attempt.started or message.kind == STARTED
                attempt.answered = attempt.answered or message.kind in ("done", "failed")
                self._messages.append((attempt.job.key, message))
        if result is not None and attempt.ended_at is None:
            attempt.ended_at = now
            self._driver.dismiss(attempt.place)  # where a machine is out of reach, what runs there ends
        if last is not None or (attempt.ended_at is not None and now - attempt.ended_at >= _SECONDS_FOR_LAST_WORDS):
            why = (last and last.text) or result or f"it ended without a word, see {attempt.place.parent}"
            self._ended(attempt, why)

    def _ended(self, attempt: _Attempt, why: str) -> None:
        """Sends a job again that has not answered, or gives it up."""
        self._drop(attempt)
        if attempt.answered or self._stopping:
            self._messages.append((attempt.job.key, Message(ENDED, _STOPPED)))
        elif attempt.number > self._settings.retries:
            text = f"it was lost {attempt.number} times, at last because {why}"
            self._messages.append((attempt.job.key, Message(ENDED, text)))
        else:
            text = f"lost ({why}); it is done again, time {attempt.number + 1} of {self._settings.retries + 1}"
            self._messages.append((attempt.job.key, Message(AGAIN, text)))
            self._send(attempt.job, attempt.number + 1)

    def stop(self) -> None:
        """Asks the jobs under way to stop, and takes the others out of the queue."""
        self._stopping = True
        for attempt in list(self._attempts.values()):
            if not attempt.started:
                self._ended(attempt, _STOPPED)
        self._driver.stop()

    def close(self) -> None:
        """Ends what is left."""
        for attempt in list(self._attempts.values()):
            self._drop(attempt)
        self._executor.close()
        self._environment.close()

    def _drop(self, attempt: _Attempt) -> None:
        del self._attempts[attempt.job.key]
        self._driver.dismiss(attempt.place)
        self._executor.cancel(attempt.handle)
