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
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any

from pipeline.jobs.display import JobDisplay
from pipeline.jobs.engines.local import LocalEngine, available_workers
from pipeline.jobs.engines.settings import EngineSettings, RaySettings, SlurmSettings
from pipeline.jobs.machine import CPU, Machine
from pipeline.jobs.worker import AGAIN, ENDED, STARTED, Job, Message, Report
from pipeline.store.costs import keep_cost
from pipeline.store.errors import StageError
from pipeline.store.interruption import stop_if_interrupted
from pipeline.store.run_folder import RunFolder

if TYPE_CHECKING:
    from pipeline.jobs.engines.cluster import ClusterEngine

Available = Callable[[], int]
_CHOSEN: ContextVar[tuple[EngineSettings | None, Available]] = ContextVar("engine", default=(None, lambda: sys.maxsize))


@contextlib.contextmanager
def chosen_engine(settings: EngineSettings | None, available: Available = lambda: sys.maxsize) -> Iterator[None]:
    """Has a stage's jobs run by an engine (None: this machine), with so many free bytes here, while the body runs."""
    token = _CHOSEN.set((settings, available))
    try:
        yield
    finally:
        _CHOSEN.reset(token)


def make_engine(
    folder: RunFolder, *, workers: int, preload: Sequence[str], device: str
) -> LocalEngine | ClusterEngine:  # fmt: skip
    """The chosen engine, the local one where none was chosen; arguments are those of `run_jobs`."""
    settings, available = _CHOSEN.get()
    if not isinstance(settings, RaySettings | SlurmSettings):
        workers = workers or available_workers()
        return LocalEngine(Machine.here(workers, available, device), workers, preload)
    from pipeline.jobs.engines.cluster import JOBS, ClusterEngine

    place = folder.path.absolute() / JOBS
    place.mkdir(parents=True, exist_ok=True)
    if isinstance(settings, SlurmSettings):
        from pipeline.jobs.engines.slurm import SlurmExecutor

        workers = min(workers or settings.jobs, settings.jobs or workers)
        return ClusterEngine(folder, SlurmExecutor(settings, place), settings, device=device, at_once=workers)
    from pipeline.jobs.engines.ray_cluster import RayExecutor

    return ClusterEngine(folder, RayExecutor(settings), settings, device=device, at_once=workers)


__all__ = ["Job", "Report", "run_jobs"]

SECONDS_TO_STOP = 60.0  # that a job may take to write its checkpoint
_SECONDS_BETWEEN_LOOKS = 0.25
_NAMED = 5  # failed jobs in the sentence

_LOGGER = logging.getLogger(__name__)


def run_jobs(
    folder: RunFolder,
    jobs: Sequence[Job],
    *,
    workers: int = 0,
    label: str = "jobs",
    preload: Sequence[str] = (),
    device: str = CPU,
) -> dict[str, Any]:
    """Runs the jobs that are not done yet, several beside each other, by the engine that was chosen.

    A job starts when the memory that it needs is free; beside GPUs, also on one of them. It sees no other.

    Args:
        folder: of the stage; keeps what is done.
        jobs: all of the stage, in the order in which they should start.
        workers: jobs beside each other; 0: as many as the engine has room for, on one machine one a core.
        preload: modules that every job needs beside that of its function; on one machine they are imported once, before
            the first jobs of this process, and the jobs' processes start with them.

    Returns:
        Key to what each job returned, also those of an earlier, interrupted run.

    Raises:
        StageError: jobs failed or were killed; it names them, and the others are done.
        ValueError: two jobs have the same key, or one waits for a job that there is not.
    """
    for number, job in enumerate(jobs):
        if missing := set(job.after).difference(earlier.key for earlier in jobs[:number]):
            raise ValueError(f"job {job.key} waits for {', '.join(sorted(missing))}: list those before it")
    todo = folder.pending(jobs, key=lambda job: job.key)
    if todo:
        modules = dict.fromkeys(job.run.__module__ for job in todo)
        engine = make_engine(folder, workers=workers, preload=[*modules, *preload], device=device)
        try:
            for job in todo:
                engine.check(job)
            with JobDisplay(label, [job.key for job in jobs], [job.key for job in todo]) as display:
                failures = _Pool(folder, todo, display, engine).run()
        finally:
            engine.close()
        if failures:
            named = "; ".join(f"{key} ({reason})" for key, reason in list(failures.items())[:_NAMED])
            more = f"; and {len(failures) - _NAMED} more" if len(failures) > _NAMED else ""
            raise StageError(
                f"{len(failures)} of {len(jobs)} {label} failed: {named}{more}. The others are kept; the same command "
                "tries these again"
            )
    return {job.key: folder.result_of(job.key) for job in jobs}


class _Pool:
    """The jobs of a stage: which may start, which are under way, which have failed."""

    def __init__(self, folder: RunFolder, todo: Sequence[Job], display: JobDisplay, engine: Any) -> None:
        self._folder, self._waiting, self._display, self._engine = folder, list(todo), display, engine
        self._taken: dict[str, Job] = {}
        self._answers: dict[str, Message] = {}
        self._failures: dict[str, str] = {}
        self._messages: deque[tuple[str, Message]] = deque()  # an interruption in the middle loses none
        self._stopping = False

    def run(self) -> dict[str, str]:
        """Runs everything; returns key to reason of those that failed."""
        try:
            while self._waiting or self._taken:
                self._submit_what_can()
                self._listen()
                self._display.show()
                stop_if_interrupted()
        finally:  # jobs under way write their checkpoints; a second Ctrl-C waits no more
            self._stopping = True
            self._engine.stop()
            deadline = time.monotonic() + SECONDS_TO_STOP
            while self._taken and time.monotonic() < deadline:
                self._listen()
        return self._failures

    def _submit_what_can(self) -> None:
        for job in list(self._waiting):
            broken = [key for key in job.after if key in self._failures]
            if broken:
                self._waiting.remove(job)
                self._fail(job.key, f"it needs {broken[0]}")
            elif any(self._folder.result_of(key) is None for key in job.after):
                continue
            elif self._engine.submit(job):
                self._waiting.remove(job)
                self._taken[job.key] = job

    def _listen(self) -> None:
        if not self._messages:
            self._messages.extend(self._engine.listen(_SECONDS_BETWEEN_LOOKS))
        while self._messages:
            self._take(*self._messages.popleft())

    def _take(self, key: str, message: Message) -> None:
        state = self._display.states[key]
        if message.cost is not None:
            keep_cost(self._folder.path, key, message.cost)
        if message.kind == STARTED:
            state.start()
        elif message.kind == AGAIN:
            state.status = "waiting"
            _LOGGER.warning("%s: %s", key, message.text)
        elif message.kind == "progress":
            state.update(message.fraction, message.text)
        elif message.kind == "log":
            _LOGGER.log(message.level, "%s: %s", key, message.text)
        elif message.kind in ("done", "failed"):
            self._answers[key] = message
            if message.traceback:
                _LOGGER.error("%s failed:\n%s", key, message.traceback.rstrip())
        elif message.kind == ENDED:
            self._ended(key, self._answers.get(key, message))

    def _ended(self, key: str, answer: Message) -> None:
        del self._taken[key]
        if answer.kind == "done":
            self._folder.mark_done(key, answer.result)
            self._display.states[key].finish()
        elif not self._stopping:  # then what is left unfinished is finished by the next run
            self._fail(key, answer.text or "unknown error")

    def _fail(self, key: str, reason: str) -> None:
        self._failures[key] = reason
        self._display.states[key].status = "failed"
        _LOGGER.warning("%s failed: %s", key, reason)
