"""The engine of a cluster: sends jobs out, reads what they report in a shared folder, sends lost ones again.

A job that has failed by itself is not sent again. One whose machine was lost is, as often as the setting says, once it
is certain that nothing of it runs any more: its process has said so, or has had no sign of life for as long as it would
work on by itself.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import shutil
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.jobs.engines.cluster import Cluster, Needs
from pipeline.jobs.engines.interface import AGAIN, ENDED, LOST, STARTED, Engine, Notes
from pipeline.jobs.engines.local import ONE_THREAD
from pipeline.jobs.engines.sending import Errand, Order
from pipeline.jobs.engines.settings import ClusterSettings
from pipeline.jobs.engines.shared_files import ENDED_FILE, REVOKED, STOP, Driver, MessageReader
from pipeline.jobs.gpus import AUTO, CPU
from pipeline.jobs.job import Job
from pipeline.jobs.worker import Message
from pipeline.store.errors import StageError
from pipeline.store.finished_items import safe_name

_SECONDS_BETWEEN_LOOKS = 0.5
_SECONDS_FOR_LAST_WORDS = 5.0  # until what a job wrote can be seen here, after its scheduler says that it has ended
_STOPPED = "it was stopped"
# Variables that jobs are given beside those of their machine.
_CARRIED = ("CATHSIM_", "MUJOCO_GL", "PYTHONPATH", "XDG_CACHE_HOME")


@dataclass
class _Attempt:
    """A job that was sent out."""

    job: Job
    notes: Notes
    number: int
    place: Path
    handle: Any
    reader: MessageReader
    started: bool = False
    answered: bool = False
    ended_at: float | None = None  # when its scheduler said so
    again_at: float | None = None  # it is lost: when it is sent again at the latest
    over: bool = False


class RemoteEngine(Engine):
    """Jobs on the machines of a cluster."""

    def __init__(
        self, stage: Path, cluster: Cluster, settings: ClusterSettings, *, device: str = CPU, at_once: int = 0
    ) -> None:  # fmt: skip
        """Args:
        stage: its folder, which this process has locked.
        device: `stage.device`.
        at_once: jobs in the queue; 0: no limit.
        """
        if ":" in device:
            raise StageError(f"stage.device={device} names a GPU of one machine: on a cluster take cuda, auto or cpu")
        self._stage, self._cluster, self._settings = stage.absolute(), cluster, settings
        self._on_gpus = device != CPU and (device != AUTO or cluster.has_gpus)
        self._at_once = at_once
        self.capacity = min(at_once or cluster.capacity, cluster.capacity)
        self._attempts: dict[str, _Attempt] = {}
        self._messages: list[tuple[str, Message]] = []
        self._stopping, self._looked = False, float("-inf")
        self._driver = Driver(self._stage, settings.lease_s).start()
        for old in self._driver.path.parent.iterdir():  # of earlier runs, which have ended
            if old.is_dir():
                shutil.rmtree(old, ignore_errors=True)

    def check(self, jobs: Sequence[Job]) -> None:
        """Refuses jobs for which no machine is large enough."""
        for job in jobs:
            if not self._cluster.fits(self._needs(job)):
                raise StageError(
                    f"{job.key} needs {self._needs(job)}, and no machine of the cluster has so much: add one, or lower "
                    "engine.memory_gb or the stage's sizes"
                )

    def _needs(self, job: Job) -> Needs:
        gpus = job.gpus if self._on_gpus and job.gpu_gb else 0
        return Needs(job.cpus, gpus, max(job.memory_gb, self._settings.memory_gb))

    def submit(self, job: Job, notes: Notes) -> bool:
        """Queues a job; the cluster starts it when it has room."""
        if self._at_once and len(self._attempts) >= self._at_once:
            return False
        self._attempts[job.key] = self._send(job, notes, 1)
        return True

    def _send(self, job: Job, notes: Notes, number: int) -> _Attempt:
        place = self._driver.path.parent / f"{safe_name(job.key)}-{self._driver.token[:8]}-{number}"
        place.mkdir()
        needs = self._needs(job)
        order = Order(
            attempt=place,
            token=self._driver.token,
            notes=(notes.folder.absolute(), notes.journal.absolute()),
            job=pickle.dumps((job.run, job.given)),
            gpu=needs.gpus > 0,
            lease_s=self._settings.lease_s,
        )
        carried = {name: value for name, value in os.environ.items() if name.startswith(_CARRIED)}
        errand = Errand(str(place), sys.executable, os.getcwd(), {**carried, **ONE_THREAD}, pickle.dumps(order))
        handle = self._cluster.submit(f"{notes.folder.name} {job.key}", errand, needs)
        return _Attempt(job, notes, number, place, handle, MessageReader(place))

    def listen(self, timeout_s: float) -> list[tuple[str, Message]]:
        """Reads what has come in the shared folder."""
        wait_s = max(min(timeout_s, self._looked + _SECONDS_BETWEEN_LOOKS - time.monotonic()), 0.0)
        time.sleep(wait_s)
        if time.monotonic() - self._looked >= _SECONDS_BETWEEN_LOOKS:
            self._looked = time.monotonic()
            for attempt in list(self._attempts.values()):
                self._look_at(attempt)
        messages, self._messages = self._messages, []
        return messages

    def _look_at(self, attempt: _Attempt) -> None:
        if attempt.again_at is not None:
            if (attempt.place / ENDED_FILE).exists() or time.monotonic() >= attempt.again_at:
                self._attempts[attempt.job.key] = self._send(attempt.job, attempt.notes, attempt.number + 1)
            return
        ended = self._cluster.ended(attempt.handle)  # before reading: what it wrote is read now or at a later look
        for message in attempt.reader.new():
            self._take(attempt, message)
        if ended is None or attempt.over:
            return
        now = time.monotonic()
        attempt.ended_at = now if attempt.ended_at is None else attempt.ended_at
        if now - attempt.ended_at >= _SECONDS_FOR_LAST_WORDS:
            self._lost(attempt, ended or f"it ended without a word, see {attempt.place}")

    def _take(self, attempt: _Attempt, message: Message) -> None:
        if attempt.over:
            return
        if message.kind == LOST:
            self._lost(attempt, message.text)
        elif message.kind == ENDED:
            self._end(attempt, message.text)
        else:
            attempt.started = attempt.started or message.kind == STARTED
            attempt.answered = attempt.answered or message.kind in ("done", "failed")
            self._messages.append((attempt.job.key, message))

    def _end(self, attempt: _Attempt, how: str) -> None:
        attempt.over = True
        self._attempts.pop(attempt.job.key, None)
        self._messages.append((attempt.job.key, Message(ENDED, how)))

    def _lost(self, attempt: _Attempt, why: str) -> None:
        """Sends a job again whose machine is gone, or gives it up."""
        if attempt.answered or self._stopping:
            self._end(attempt, _STOPPED)
        elif attempt.number > self._settings.retries:
            self._end(attempt, f"it was lost {attempt.number} times, at last because {why}")
        else:
            attempt.over = True
            attempt.again_at = time.monotonic() + self._settings.lease_s
            self._write(attempt, REVOKED)
            self._cluster.cancel(attempt.handle)
            text = f"lost ({why}); it is done again, time {attempt.number + 1} of {self._settings.retries + 1}"
            self._messages.append((attempt.job.key, Message(AGAIN, text)))

    def stop(self) -> None:
        """Asks the jobs under way to stop, and takes the others out of the queue."""
        self._stopping = True
        for attempt in list(self._attempts.values()):
            if attempt.started and attempt.again_at is None:
                self._write(attempt, STOP)
            else:
                self._drop(attempt)
                self._end(attempt, _STOPPED)

    def close(self) -> None:
        """Ends what is left."""
        for attempt in self._attempts.values():
            self._drop(attempt)
        self._attempts = {}
        self._driver.close()
        self._cluster.close()

    def _drop(self, attempt: _Attempt) -> None:
        self._write(attempt, REVOKED)
        self._cluster.cancel(attempt.handle)

    @staticmethod
    def _write(attempt: _Attempt, name: str) -> None:
        with contextlib.suppress(OSError):
            (attempt.place / name).touch()
