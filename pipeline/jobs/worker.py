"""A job, and its process: it runs the job, reports its progress, and ends when it is to stop or its stage is gone."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import logging
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

from pydantic import ValidationError

from pipeline.jobs.machine import CPU, CUDA, CUDA_CONTEXT_BYTES, VISIBLE
from pipeline.settings.kinds import sentence
from pipeline.store.costs import Cost, CostMeter
from pipeline.store.errors import PipelineError, system_sentence

_MMAP_THRESHOLD = -3  # M_MMAP_THRESHOLD of malloc.h
_OF_A_SIMULATION = 12 * 2**20  # bytes; MuJoCo's arenas are larger


def return_freed_memory() -> None:
    """Frees what only refers to itself, and returns freed memory to the system: up to half of what a training takes."""
    gc.collect()
    with contextlib.suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def map_simulations() -> None:
    """Lets MuJoCo's arenas lie in pages of their own from now on, which go back at once.

    For jobs that make simulations by the thousand: every anatomy has some twenty, each with an arena of 16 MB of which
    it uses a hundredth, and on the heap the used parts pile up. Networks on images would allocate more slowly.
    """
    with contextlib.suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).mallopt(_MMAP_THRESHOLD, _OF_A_SIMULATION)


_SECONDS_BETWEEN_MESSAGES = 0.5
_SECONDS_BETWEEN_TRIMS = 60.0
_EXIT_LEFT_ALONE = 1
STARTED, ENDED, AGAIN, LOST = "started", "ended", "again", "lost"


@dataclass(frozen=True)
class Message:
    """What the stage is told of a job: "started", "progress", "log", "done" or "failed", and at the end "ended".

    The text of "ended" is the reason where the job has not answered. "again": its machine was lost, and it will start
    once more. "lost" ends the messages of a machine of a cluster where a job did not end by itself.
    """

    kind: str
    text: str = ""
    fraction: float = 0.0
    level: int = logging.INFO
    traceback: str = ""
    result: Any = None
    gpu_bytes: int = 0  # that the process uses of its GPU's memory
    cost: Cost | None = None  # of a job that has ended


class Report:
    """Where a job reports its progress, and learns where to compute and when to stop."""

    def __init__(self, send: Callable[[Message], None] | None = None, device: str = "cpu") -> None:
        """Messages go to `send`; networks belong on `device`, "cpu", or "cuda", which is the job's own GPU."""
        self._send, self.device = send, device
        self.stopping = False  # whether the job is to stop; no lock: a signal's handler sets it
        self._last, self._trimmed = 0.0, time.monotonic()

    def __call__(self, fraction: float, text: str = "") -> None:
        """Reports the progress; call it often, it is cheap.

        Args:
            fraction: of the whole job, 0 to 1.
            text: a few words, e.g. ``success 0.8``.

        Raises:
            KeyboardInterrupt: the job is to write its checkpoint and leave.
        """
        if self.stopping:
            raise KeyboardInterrupt
        now = time.monotonic()
        if self._send is not None and now - self._last >= _SECONDS_BETWEEN_MESSAGES:
            self._last = now
            share = min(max(float(fraction), 0.0), 1.0)
            self._send(Message("progress", text, fraction=share, gpu_bytes=_gpu_bytes()))
            if now - self._trimmed >= _SECONDS_BETWEEN_TRIMS:
                self._trimmed = now
                return_freed_memory()

    def part(self, start: float, end: float, label: str = "") -> Callable[[float, str], None]:
        """A report for a part of the job, from `start` (share of the job that is done before it) to `end`."""

        def report(fraction: float, text: str = "") -> None:
            self(start + (end - start) * min(max(fraction, 0.0), 1.0), f"{label} {text}".strip())

        return report

    def stop(self) -> None:
        """From here on every call raises `KeyboardInterrupt`."""
        self.stopping = True


class _ToStage(logging.Handler):
    """Passes warnings on, so that they stand in the stage's log."""

    def __init__(self, send: Callable[[Message], None], report: Report) -> None:
        super().__init__(logging.WARNING)
        self._pass_on, self._report = send, report

    def emit(self, record: logging.LogRecord) -> None:
        if not self._report.stopping:  # what is left unfinished is finished by the next run
            self._pass_on(Message("log", record.getMessage(), level=record.levelno))


def _gpu_bytes() -> int:
    """The most that this process has used of its GPU's memory."""
    torch: Any = sys.modules.get("torch")
    if torch is None or not torch.cuda.is_initialized():
        return 0
    return int(torch.cuda.max_memory_reserved()) + CUDA_CONTEXT_BYTES


def work(
    run: Callable[[Any, Report], Any],
    given: Any,
    connection: Connection,
    gpus: tuple[str, ...] = (),
) -> None:
    """Runs a job in this process, which is its own.

    Args:
        connection: to the stage; its end means that the stage is no more.
        gpus: that it computes on, as `CUDA_VISIBLE_DEVICES` calls them; none: it sees no GPU.
    """
    os.environ[VISIBLE] = ",".join(gpus)  # before torch looks for GPUs, which it does only when it needs one
    gate = threading.Lock()

    def send(message: Message) -> None:
        with gate, contextlib.suppress(OSError):
            connection.send(message)

    report = Report(send, CUDA if gpus else CPU)
    # Ctrl-C in a terminal and a batch system's SIGTERM reach every process: a job leaves at its next report, not
    # in the middle of what its checkpoint needs whole.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *unused: report.stop())
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})  # held back while the process was started
    threading.Thread(target=_obey, args=(connection, report), daemon=True).start()
    logging.getLogger().addHandler(_ToStage(send, report))
    meter = CostMeter()
    if "torch" in sys.modules:  # preloaded
        sys.modules["torch"].set_num_threads(1)
    if "cv2" in sys.modules:
        sys.modules["cv2"].setNumThreads(1)
    try:
        result = run(given, report)
    except KeyboardInterrupt:
        pass  # whoever stopped it does not wait for an answer
    except (PipelineError, ValidationError) as error:
        reason = sentence(error) if isinstance(error, ValidationError) else str(error)
        send(Message("failed", reason, cost=meter.read(reason)))
    except OSError as error:
        reason = system_sentence(error)
        send(Message("failed", reason, cost=meter.read(reason)))
    except Exception as error:
        first = next((line for line in str(error).splitlines() if line.strip()), "")
        reason = f"{type(error).__name__}: {first}" if first else type(error).__name__
        send(Message("failed", reason, traceback=traceback.format_exc(), cost=meter.read(reason)))
    else:
        send(Message("done", result=result, cost=meter.read()))
    connection.close()


def _obey(connection: Connection, report: Report) -> None:
    try:
        while True:
            connection.recv()
            report.stop()
    except (EOFError, OSError, TypeError):
        if not getattr(connection, "closed", True):
            # The stage was killed. Its lock is free: another may already work in the folder, so not one more file.
            os._exit(_EXIT_LEFT_ALONE)


PHANTOM = ("scipy.ndimage", "trimesh")  # to preload for jobs that open a phantom, which imports these when it has to
OPTIMISER = "torch._dynamo"  # to preload for jobs that train: 1.4 s of imports of the first optimiser of a process
POLICIES = (  # to preload for jobs that train policies or play episodes, each of which imports a part of these
    *PHANTOM, "cathsim.rehearsal.environment", "enn.encoder", "enn.force.evaluation", "enn.imitation.advised_episodes",
    "enn.imitation.distillation", "enn.reinforcement.rehearsal", "pipeline.recording.record", OPTIMISER,
)  # fmt: skip


@dataclass(frozen=True)
class Job:
    """A piece of work."""

    key: str  # its name in messages and in the run folder; no two of a stage share one
    # a module's function: what it is given, and where it reports its progress, to a JSON value
    run: Callable[[Any, Report], Any]
    given: Any = None  # to `run`; picklable
    after: tuple[str, ...] = ()  # keys of jobs that must be done before
    memory_gb: float = 0.0  # memory that it is expected to need; 0: too little to mind
    gpu_gb: float = 0.0  # memory of a GPU that it is expected to need; 0: it has no network and needs none
