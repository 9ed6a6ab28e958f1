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

import logging
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from enn.reinforcement.free_memory import available_bytes
from pipeline.jobs.costs import keep_cost
from pipeline.jobs.display import JobDisplay, JobState
from pipeline.jobs.engines.choice import make_engine
from pipeline.jobs.engines.interface import AGAIN, ENDED, STARTED, Engine, Notes
from pipeline.jobs.gpus import CPU, Gpu, find_gpus
from pipeline.jobs.job import Job
from pipeline.jobs.worker import Message, Report
from pipeline.store.errors import StageError
from pipeline.store.interruption import stop_if_interrupted
from pipeline.store.run_folder import RunFolder

__all__ = ["Job", "Report", "run_jobs"]

SECONDS_TO_STOP = 60.0  # that a job may take to write its checkpoint
_SECONDS_BETWEEN_LOOKS = 0.25

_LOGGER = logging.getLogger(__name__)


@dataclass
class _Taken:
    """A job that the engine has taken."""

    job: Job
    state: JobState
    failure: str | None = None
    result: Any = None
    answered: bool = False


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
    """Runs the jobs that are not done yet, several beside each other, by the engine that was chosen.

    A job starts when there is room for the memory that it needs; beside GPUs, also on one of them. It sees no other.

    Args:
        folder: of the stage; keeps what is done.
        jobs: all of the stage, in the order in which they should start.
        workers: jobs beside each other; 0: as many as the engine has room for, on one machine one a core.
        preload: modules that every job needs; on one machine they are imported once, and the jobs' processes start with
            them.
        find: lists the GPUs of this machine.
        available: counts the bytes of memory that may still be taken.

    Returns:
        Key to what each job returned, also those of an earlier, interrupted run.

    Raises:
        StageError: jobs failed or were killed; it names them, and the others are done.
        ValueError: two jobs have the same key, or one waits for a job that there is not.
    """
    _check_order(jobs)
    todo = _to_do(folder, jobs)
    failures: dict[str, str] = {}
    if todo:
        engine = make_engine(folder, workers=workers, preload=preload, device=device, find=find, available=available)
        with engine:
            engine.check(todo)
            states = [JobState(job.key, job.weight, done=job not in todo) for job in jobs]
            with JobDisplay(label, states, workers=engine.capacity) as display:
                failures = _Pool(folder, todo, display, engine).run()
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


class _Pool:
    """The jobs of a stage: which may start, which are under way, which have failed."""

    def __init__(self, folder: RunFolder, todo: Sequence[Job], display: JobDisplay, engine: Engine) -> None:
        self._folder, self._waiting, self._display, self._engine = folder, list(todo), display, engine
        self._taken: dict[str, _Taken] = {}
        self._failures: dict[str, str] = {}
        self._unknown: set[str] = set()  # jobs that have to run
        self._messages: deque[tuple[str, Message]] = deque()  # an interruption in the middle loses none
        self._stopping = False

    def run(self) -> dict[str, str]:
        """Runs everything; returns key to reason of those that failed."""
        try:
            while self._waiting or self._taken:
                self._submit_what_can()
                self._listen(_SECONDS_BETWEEN_LOOKS)
                self._display.show()
                stop_if_interrupted()
        finally:
            self._stop()
        return self._failures

    def _submit_what_can(self) -> None:
        for job in list(self._waiting):
            broken = [key for key in job.after if key in self._failures]
            if broken:
                self._waiting.remove(job)
                self._fail(job.key, f"it needs {broken[0]}")
            elif not self._is_ready(job):
                continue
            elif self._is_known(job):
                self._waiting.remove(job)
                self._display.states[job.key].leave_out()
            elif self._engine.submit(job, Notes.of(self._folder, job)):
                self._waiting.remove(job)
                self._taken[job.key] = _Taken(job, self._display.states[job.key])

    def _is_known(self, job: Job) -> bool:
        """Whether a job need not run; then its result is kept. Asked once, as what it rests on is there."""
        if job.known is None or job.key in self._unknown:
            return False
        result = job.known(job.given)
        if result is None:
            self._unknown.add(job.key)
            return False
        self._folder.mark_done(job.key, result)
        return True

    def _is_ready(self, job: Job) -> bool:
        return all(self._folder.result_of(key) is not None for key in job.after)

    def _listen(self, timeout_s: float) -> None:
        if not self._messages:
            self._messages.extend(self._engine.listen(timeout_s))
        while self._messages:
            key, message = self._messages.popleft()
            self._take(self._taken[key], message)

    def _take(self, taken: _Taken, message: Message) -> None:
        key = taken.job.key
        if message.cost is not None:
            keep_cost(self._folder.path, key, message.cost, taken.job.after)
        if message.kind == STARTED:
            taken.state.start()
        elif message.kind == AGAIN:
            taken.state.wait()
            _LOGGER.warning("%s: %s", key, message.text)
        elif message.kind == "progress":
            taken.state.update(message.fraction, message.text)
        elif message.kind == "log":
            _LOGGER.log(message.level, "%s: %s", key, message.text)
        elif message.kind == "failed":
            taken.answered, taken.failure = True, message.text
            if message.traceback:
                _LOGGER.error("%s failed:\n%s", key, message.traceback.rstrip())
        elif message.kind == "done":
            taken.answered, taken.result = True, message.result
        elif message.kind == ENDED:
            self._ended(taken, message.text)

    def _ended(self, taken: _Taken, how: str) -> None:
        key = taken.job.key
        del self._taken[key]
        if taken.answered and taken.failure is None:
            self._folder.mark_done(key, taken.result)
            taken.state.finish()
        elif self._stopping:
            return  # what is left unfinished is finished by the next run
        else:
            self._fail(key, taken.failure or "unknown error" if taken.answered else how)

    def _fail(self, key: str, reason: str) -> None:
        self._failures[key] = reason
        self._display.states[key].fail()
        _LOGGER.warning("%s failed: %s", key, reason)

    def _stop(self) -> None:
        """Asks the jobs under way to stop, and waits for their checkpoints; a second Ctrl-C waits no more.

        One that was just done counts as done.
        """
        self._stopping = True
        self._engine.stop()
        deadline = time.monotonic() + SECONDS_TO_STOP
        while self._taken and time.monotonic() < deadline:
            self._listen(_SECONDS_BETWEEN_LOOKS)
