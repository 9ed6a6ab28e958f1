"""The engine of one machine: a process a job, with one thread for numerics, as many beside each other as have room.

Each process is new, since a job leaves memory, threads and a GPU's context behind, and may be killed without harm to
others; pools that keep their processes (loky, `concurrent.futures`) end all jobs when one is killed. The modules that
jobs need are imported once, in the server that the processes are forked from.
"""

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

from pipeline.jobs.machine import Machine
from pipeline.jobs.worker import ENDED, STARTED, Job, Message, work

SECONDS_TO_JOIN = 60.0  # that a process may take to end once it has closed its connection
# One thread a process: the jobs already use every core.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")


@dataclass
class _Running:
    key: str
    process: Any
    connection: Connection


class LocalEngine:
    """Processes of this machine."""

    def __init__(self, machine: Machine, workers: int, preload: Sequence[str]) -> None:
        """For so many jobs of a stage at the same time, which share a machine, maybe with those of other stages."""
        self._workers, self._machine = workers, machine
        self._running: list[_Running] = []
        self._messages: list[tuple[str, Message]] = []
        self._open = contextlib.ExitStack()
        self._open.enter_context(variables_set(ONE_THREAD))
        # A forked copy of this process would inherit the lock, the log's file and the threads of libraries.
        if multiprocessing.get_start_method(allow_none=True) not in (None, *multiprocessing.get_all_start_methods()):
            # joblib's workers name a method of their own, which the processes they start do not know
            multiprocessing.set_start_method("spawn", force=True)
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload(["pipeline.jobs.worker", *preload])
        with ctrl_c_held_back():
            forkserver.ensure_running()

    def check(self, job: Job) -> None:
        """Refuses a job for which the memory or a GPU is too small."""
        self._machine.check(job)

    def submit(self, job: Job) -> bool:
        """Starts a job when a core, the memory and the GPUs that it needs are free."""
        if len(self._running) >= self._workers or (gpus := self._machine.take(job)) is None:
            return False
        ours, theirs = self._context.Pipe()
        arguments = (job.run, job.given, theirs, tuple(gpu.visible for gpu in gpus))
        process = self._context.Process(target=work, args=arguments, name=job.key)
        process.start()
        theirs.close()  # or the end of the job's process would not end the connection
        self._running.append(_Running(job.key, process, ours))
        self._messages.append((job.key, Message(STARTED)))
        return True

    def listen(self, timeout_s: float) -> list[tuple[str, Message]]:
        """Waits for messages of the jobs' processes."""
        ready = wait([running.connection for running in self._running], timeout_s)
        for running in [one for one in self._running if one.connection in ready]:
            try:
                while running.connection.poll():
                    message: Message = running.connection.recv()
                    if message.gpu_bytes:
                        self._machine.measured(running.key, message.gpu_bytes)
                    self._messages.append((running.key, message))
            except (EOFError, OSError):  # done, failed, stopped or killed
                self._running.remove(running)
                running.process.join(SECONDS_TO_JOIN)
                running.connection.close()
                self._machine.free(running.key)
                self._messages.append((running.key, Message(ENDED, how_it_ended(running.process.exitcode or 0))))
        messages, self._messages = self._messages, []
        return messages

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
            self._machine.free(running.key)
        self._open.close()


def how_it_ended(code: int) -> str:
    """Words the end, as of `multiprocessing.Process.exitcode`, of a process that has not answered."""
    return f"its process was killed by signal {-code}" if code < 0 else "it was stopped"


def available_workers() -> int:
    """How many processes may run beside each other: one a core that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextlib.contextmanager
def variables_set(values: Mapping[str, str]) -> Iterator[None]:
    """Sets variables of the environment, which processes that start inside inherit, and undoes it."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
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
