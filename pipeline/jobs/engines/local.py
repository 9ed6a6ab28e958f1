"""The engine of one machine: a process a job, with one thread for numerics, as many beside each other as have room."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import Connection, wait
from typing import Any

from pipeline.jobs.engines.interface import ENDED, STARTED, Engine, Notes
from pipeline.jobs.engines.shared_machine import Core, SharedMachine
from pipeline.jobs.gpus import GpuShare
from pipeline.jobs.job import Job
from pipeline.jobs.worker import Message, work
from pipeline.store.errors import StageError

SECONDS_TO_JOIN = 60.0  # that a process may take to end once it has closed its connection
# One thread a process: the jobs already use every core.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")


@dataclass
class _Running:
    job: Job
    process: Any
    connection: Connection
    core: Core | None = None  # where stages beside each other share them


class LocalEngine(Engine):
    """Processes of this machine."""

    def __init__(
        self,
        workers: int,
        preload: Sequence[str],
        share: GpuShare,
        room_gb: float,
        machine: SharedMachine | None = None,
    ) -> None:
        """Args:
        workers: processes beside each other.
        preload: modules that every job needs; they are imported once, and the jobs' processes start with them.
        room_gb: memory that jobs may take.
        machine: shared with other stages, whose memory counts instead of `room_gb`; None: this stage has all.
        """
        self.capacity, self._share, self._machine = workers, share, machine
        self._room_gb = room_gb if machine is None else machine.room_gb
        self._running: list[_Running] = []
        self._messages: list[tuple[str, Message]] = []
        self._open = contextlib.ExitStack()
        self._open.enter_context(_one_thread())
        # A forked copy of this process would inherit the lock, the log's file and the threads of libraries.
        if multiprocessing.get_start_method(allow_none=True) not in (None, *multiprocessing.get_all_start_methods()):
            # joblib's workers name a method of their own, which the processes they start do not know
            multiprocessing.set_start_method("spawn", force=True)
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload(["pipeline.jobs.worker", *preload])
        with ctrl_c_held_back():
            forkserver.ensure_running()

    def check(self, jobs: Sequence[Job]) -> None:
        """Refuses jobs for which a GPU or the memory is too small."""
        if self._share.gpus:
            for job in jobs:
                self._share.require_room(job.key, job.gpu_gb, job.gpus)
        for job in jobs:
            if job.memory_gb > self._room_gb:
                raise StageError(
                    f"{job.key} needs about {job.memory_gb:.1f} GB of memory, {self._room_gb:.1f} GB are available: "
                    "end other programs, or make it smaller (stage.decisions or the side of the images, for a training)"
                )

    def submit(self, job: Job, notes: Notes) -> bool:
        """Starts a job when a core, the memory and the GPUs that it needs are free."""
        if len(self._running) >= self.capacity or not self._has_memory(job):
            return False
        with self._turn() as machine:
            core = None if machine is None else machine.take(job.memory_gb)
            if machine is not None and core is None:
                return False
            gpus = self._gpus(job, {} if machine is None else machine.gpu_bytes_elsewhere())
            if core is not None:
                core.promise(self._share.promised(job.key))
        if gpus is None:
            if core is not None:
                core.free()
            return False
        ours, theirs = self._context.Pipe()
        given = (job.run, job.given, theirs, (notes.folder, notes.journal), gpus)
        process = self._context.Process(target=work, args=given, name=job.key)
        process.start()
        theirs.close()  # or the end of the job's process would not end the connection
        self._running.append(_Running(job, process, ours, core))
        self._messages.append((job.key, Message(STARTED)))
        return True

    def _has_memory(self, job: Job) -> bool:
        return job.memory_gb + sum(running.job.memory_gb for running in self._running) <= self._room_gb

    @contextlib.contextmanager
    def _turn(self) -> Iterator[SharedMachine | None]:
        """Keeps other stages from taking the same; the machine where one is shared."""
        with contextlib.nullcontext() if self._machine is None else self._machine.turn():
            yield self._machine

    def _gpus(self, job: Job, elsewhere: Mapping[str, float]) -> tuple[str, ...] | None:
        """What the job's GPUs are called: none where it needs none; None while they have no room for it."""
        if not (self._share.gpus and job.gpu_gb):
            return ()
        taken = self._share.take(job.key, job.gpu_gb, job.gpus, elsewhere)
        return None if taken is None else tuple(gpu.visible for gpu in taken)

    def listen(self, timeout_s: float) -> list[tuple[str, Message]]:
        """Waits for messages of the jobs' processes."""
        ready = wait([running.connection for running in self._running], timeout_s)
        for running in [r for r in self._running if r.connection in ready]:
            key = running.job.key
            try:
                while running.connection.poll():
                    message: Message = running.connection.recv()
                    if message.gpu_bytes:
                        self._measured(running, message.gpu_bytes)
                    self._messages.append((key, message))
            except (EOFError, OSError):
                self._messages.append((key, self._ended(running)))
        messages, self._messages = self._messages, []
        return messages

    def _measured(self, running: _Running, gpu_bytes: int) -> None:
        """A job says how much of each of its GPUs it uses."""
        key = running.job.key
        before = self._share.promised(key)
        self._share.measured(key, gpu_bytes)
        if running.core is not None and self._share.promised(key) != before:
            with self._turn():
                running.core.promise(self._share.promised(key))

    def _ended(self, running: _Running) -> Message:
        """A job's process has closed its connection: done, failed, stopped or killed."""
        self._running.remove(running)
        running.process.join(SECONDS_TO_JOIN)
        running.connection.close()
        self._share.give_back(running.job.key)
        if running.core is not None:
            running.core.free()
        return Message(ENDED, how_it_ended(running.process.exitcode))

    def stop(self) -> None:
        """Asks the jobs under way to stop."""
        for running in self._running:
            with contextlib.suppress(OSError):
                running.connection.send("stop")

    def close(self) -> None:
        """Kills what is still running."""
        for running in self._running:
            running.process.kill()
            running.process.join()
            if running.core is not None:
                running.core.free()
        self._open.close()


def available_workers() -> int:
    """How many processes may run beside each other: one a core that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def how_it_ended(code: int | None) -> str:
    """Words the end of a process that has not answered.

    Args:
        code: as `multiprocessing.Process.exitcode`.
    """
    code = code or 0
    return f"its process was killed by signal {-code}" if code < 0 else "it was stopped"


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextlib.contextmanager
def ctrl_c_held_back() -> Iterator[None]:
    """Lets no Ctrl-C reach what starts inside: a job still importing would print a traceback.

    This process gets one that comes meanwhile when it leaves; ignored instead, it would be lost.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    resource_tracker.ensure_running()  # which, when it starts, lets the signal through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
