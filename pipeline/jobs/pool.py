"""Jobs: independent pieces of a stage's work in processes of their own, resumable one by one.

A job is a function of a module and what it is given, both picklable. It runs in a fresh process with one thread for
numerics, reports its progress through its `Report`, and returns what `RunFolder.mark_done` keeps for the stage's
summary. What it had begun when it was stopped it finds again in its own files: a finished job never runs twice, an
unfinished one goes on from its checkpoint.

How a job ends early:

- The stage is stopped (Ctrl-C, SIGTERM): the next `report` in each job raises `KeyboardInterrupt`, so that a training
  writes its checkpoint and leaves.
- The stage is killed: its jobs notice at once and end where they stand.
- A job fails, or its process is killed: the others go on, and `run_jobs` names it at the end.
"""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import forkserver
from multiprocessing.connection import Connection, wait
from typing import Any

from enn.reinforcement.free_memory import available_bytes
from pipeline.jobs.costs import keep_cost
from pipeline.jobs.display import JobDisplay, JobState
from pipeline.jobs.gpus import CPU, Gpu, GpuShare, find_gpus, gpus_of
from pipeline.jobs.worker import Message, Report, work
from pipeline.store.errors import StageError
from pipeline.store.interruption import stop_if_interrupted
from pipeline.store.run_folder import RunFolder

__all__ = ["Job", "Report", "run_jobs"]

SECONDS_TO_STOP = 60.0  # that a job may take to write its checkpoint
_SECONDS_BETWEEN_LOOKS = 0.25
_GB = 1e9
# One thread a process: the jobs already use every core.
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")

_LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True)
class Job:
    """A piece of work."""

    key: str  # its name in messages and in the run folder; no two of a stage share one
    # a module's function: what it is given, and where it reports its progress, to a JSON value
    run: Callable[[Any, Report], Any]
    given: Any = None  # to `run`; picklable
    after: tuple[str, ...] = ()  # keys of jobs that must be done before
    weight: float = 1.0  # how long it takes beside the others, for the estimate of the end
    memory_gb: float = 0.0  # memory that it is expected to need; 0: too little to mind
    # GPU memory that it is expected to need, on each of its GPUs; 0: it has no network and needs none
    gpu_gb: float = 0.0
    gpus: int = 1  # how many GPUs it computes on


@dataclass
class _Running:
    job: Job
    process: Any
    connection: Connection
    state: JobState
    failure: str | None = None
    result: Any = None
    answered: bool = False


def available_workers() -> int:
    """How many processes may run beside each other: one a core that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_jobs(
    folder: RunFolder,
    jobs: Sequence[Job],
    *,
    workers: int = 0,
    label: str = "jobs",
    preload: Sequence[str] = (),
    device: str = CPU,
    find: Callable[[], Sequence[Gpu]] = find_gpus,
    available: Callable[[], int] = available_bytes,
) -> dict[str, Any]:
    """Runs the jobs that are not done yet, several beside each other.

    A job starts when there is room for the memory that it needs; beside GPUs, also on one of them. It sees no other.

    Args:
        folder: of the stage; keeps what is done.
        jobs: all of the stage, in the order in which they should start.
        workers: processes beside each other; 0: one a core.
        preload: modules that every job needs; they are imported once, and the jobs' processes start with them.
        available: counts the bytes of memory that may still be taken.

    Returns:
        Key to what each job returned, also those of an earlier, interrupted run.

    Raises:
        StageError: jobs failed or were killed; it names them, and the others are done.
        ValueError: two jobs have the same key, or one waits for a job that there is not.
    """
    _check_order(jobs)
    todo = _to_do(folder, jobs)
    states = [JobState(job.key, job.weight, done=job not in todo) for job in jobs]
    display = JobDisplay(label, states, workers=workers or available_workers())
    failures: dict[str, str] = {}
    if todo:
        share = GpuShare([] if device == CPU else gpus_of(device, find()))
        if share.gpus:
            for job in todo:
                share.require_room(job.key, job.gpu_gb, job.gpus)
        room_gb = available() / _GB
        for job in todo:
            if job.memory_gb > room_gb:
                raise StageError(
                    f"{job.key} needs about {job.memory_gb:.1f} GB of memory, {room_gb:.1f} GB are available: end "
                    "other programs, or make it smaller (stage.decisions or the side of the images, for a training)"
                )
        with display, _one_thread():
            failures = _Pool(folder, todo, display, preload, share, room_gb).run()
    if failures:
        raise StageError(_sentence(label, failures, len(jobs)))
    return {job.key: folder.result_of(job.key) for job in jobs}


def _to_do(folder: RunFolder, jobs: Sequence[Job]) -> list[Job]:
    """The jobs that are not done; what was made from one of those is made again, too."""
    todo = {job.key for job in folder.pending(jobs, key=lambda job: job.key)}
    for job in jobs:
        if job.key not in todo and todo.intersection(job.after):
            folder.forget(job.key)
            todo.add(job.key)
    return [job for job in jobs if job.key in todo]


def _check_order(jobs: Sequence[Job]) -> None:
    seen: set[str] = set()
    for job in jobs:
        missing = [key for key in job.after if key not in seen]
        if missing:
            raise ValueError(f"job {job.key} waits for {', '.join(missing)}: list those before it")
        seen.add(job.key)


def _sentence(label: str, failures: dict[str, str], total: int) -> str:
    named = "; ".join(f"{key} ({reason})" for key, reason in list(failures.items())[:5])
    more = f"; and {len(failures) - 5} more" if len(failures) > 5 else ""
    return (
        f"{len(failures)} of {total} {label} failed: {named}{more}. The others are kept; the same command tries "
        "these again"
    )


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(_ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextlib.contextmanager
def _ctrl_c_ignored() -> Iterator[None]:
    """Lets what starts inside inherit that Ctrl-C means nothing: a job still importing would print a traceback."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


class _Pool:
    """The processes of the jobs under way."""

    def __init__(
        self,
        folder: RunFolder,
        todo: Sequence[Job],
        display: JobDisplay,
        preload: Sequence[str],
        share: GpuShare,
        room_gb: float,
    ) -> None:
        self._room_gb = room_gb
        self._folder, self._waiting, self._display, self._share = folder, list(todo), display, share
        self._running: list[_Running] = []
        self._failures: dict[str, str] = {}
        self._stopping = False
        # A forked copy of this process would inherit the lock, the log's file and the threads of libraries.
        if multiprocessing.get_start_method(allow_none=True) not in (None, *multiprocessing.get_all_start_methods()):
            # joblib's workers name a method of their own, which the processes they start do not know
            multiprocessing.set_start_method("spawn", force=True)
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload(["pipeline.jobs.worker", *preload])
        with _ctrl_c_ignored():
            forkserver.ensure_running()

    def run(self) -> dict[str, str]:
        """Runs everything; returns key to reason of those that failed."""
        try:
            while self._waiting or self._running:
                self._start_what_can()
                self._listen(_SECONDS_BETWEEN_LOOKS)
                self._display.show()
                stop_if_interrupted()
        finally:
            self._stop()
        return self._failures

    def _start_what_can(self) -> None:
        for job in list(self._waiting):
            broken = [key for key in job.after if key in self._failures]
            if broken:
                self._waiting.remove(job)
                self._fail(job.key, f"it needs {broken[0]}")
            elif len(self._running) < self._display.workers and self._is_ready(job) and self._has_memory(job):
                gpus = self._gpus(job)
                if gpus is not None:
                    self._waiting.remove(job)
                    self._start(job, gpus)

    def _has_memory(self, job: Job) -> bool:
        return job.memory_gb + sum(running.job.memory_gb for running in self._running) <= self._room_gb

    def _is_ready(self, job: Job) -> bool:
        return all(self._folder.result_of(key) is not None for key in job.after)

    def _gpus(self, job: Job) -> tuple[str, ...] | None:
        """What the job's GPUs are called: none where it needs none; None while they have no room for it."""
        if not (self._share.gpus and job.gpu_gb):
            return ()
        taken = self._share.take(job.key, job.gpu_gb, job.gpus)
        return None if taken is None else tuple(gpu.visible for gpu in taken)

    def _start(self, job: Job, gpus: tuple[str, ...]) -> None:
        ours, theirs = self._context.Pipe()
        notes = (self._folder.path, self._folder.journal(job.key))
        process = self._context.Process(target=work, args=(job.run, job.given, theirs, notes, gpus), name=job.key)
        process.start()
        theirs.close()  # or the end of the job's process would not end the connection
        self._running.append(_Running(job, process, ours, self._display.states[job.key]))
        self._display.states[job.key].start()

    def _listen(self, timeout_s: float) -> None:
        ready = wait([running.connection for running in self._running], timeout_s)
        for running in [r for r in self._running if r.connection in ready]:
            try:
                while running.connection.poll():
                    self._take(running, running.connection.recv())
            except (EOFError, OSError):
                self._ended(running)

    def _take(self, running: _Running, message: Message) -> None:
        if message.cost is not None:
            keep_cost(self._folder.path, running.job.key, message.cost)
        if message.kind == "progress":
            running.state.update(message.fraction, message.text)
            if message.gpu_bytes:
                self._share.measured(running.job.key, message.gpu_bytes)
        elif message.kind == "log":
            _LOGGER.log(message.level, "%s: %s", running.job.key, message.text)
        elif message.kind == "failed":
            running.answered, running.failure = True, message.text
            if message.traceback:
                _LOGGER.error("%s failed:\n%s", running.job.key, message.traceback.rstrip())
        elif message.kind == "done":
            running.answered, running.result = True, message.result

    def _ended(self, running: _Running) -> None:
        """A job's process has closed its connection: done, failed, stopped or killed."""
        self._running.remove(running)
        running.process.join(SECONDS_TO_STOP)
        running.connection.close()
        self._share.give_back(running.job.key)
        if running.answered and running.failure is None:
            self._folder.mark_done(running.job.key, running.result)
            running.state.finish()
        elif self._stopping:
            return  # what is left unfinished is finished by the next run
        elif running.answered:
            self._fail(running.job.key, running.failure or "unknown error")
        else:
            code = running.process.exitcode or 0
            self._fail(running.job.key, f"its process was killed by signal {-code}" if code < 0 else "it was stopped")

    def _fail(self, key: str, reason: str) -> None:
        self._failures[key] = reason
        self._display.states[key].fail()
        _LOGGER.warning("%s failed: %s", key, reason)

    def _stop(self) -> None:
        """Asks the jobs under way to stop, and waits for their checkpoints; a second Ctrl-C waits no more.

        One that was just done counts as done.
        """
        self._stopping = True
        for running in self._running:
            with contextlib.suppress(OSError):
                running.connection.send("stop")
        deadline = time.monotonic() + SECONDS_TO_STOP
        try:
            while self._running and time.monotonic() < deadline:
                self._listen(_SECONDS_BETWEEN_LOOKS)
        finally:
            for running in self._running:
                running.process.kill()
                running.process.join()
