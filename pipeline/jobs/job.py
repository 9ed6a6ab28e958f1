"""A job: a piece of a stage's work, and what it needs of a machine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pipeline.jobs.worker import Report

OPTIMISER = "torch._dynamo"  # to preload for jobs that train: 1.4 s of imports of the first optimiser of a process


@dataclass(frozen=True)
class Job:
    """A piece of work."""

    key: str  # its name in messages and in the run folder; no two of a stage share one
    # a module's function: what it is given, and where it reports its progress, to a JSON value
    run: Callable[[Any, Report], Any]
    given: Any = None  # to `run`; picklable
    after: tuple[str, ...] = ()  # keys of jobs that must be done before
    # what it would return, where what it is given and the jobs before it say so; None: it has to run
    known: Callable[[Any], Any] | None = None
    weight: float = 1.0  # how long it takes beside the others, for the estimate of the end
    memory_gb: float = 0.0  # memory that it is expected to need; 0: too little to mind
    # GPU memory that it is expected to need, on each of its GPUs; 0: it has no network and needs none
    gpu_gb: float = 0.0
    gpus: int = 1  # how many GPUs it computes on
    cpus: int = 1  # cores that it keeps busy
