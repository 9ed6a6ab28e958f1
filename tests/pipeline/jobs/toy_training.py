"""Toy jobs: a training that counts, writes a checkpoint and goes on from it; one that tells where it ran."""

import errno
import json
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import pydantic.dataclasses
from annotated_types import Gt

from pipeline.jobs.machine import Gpu
from pipeline.jobs.pool import Job, run_jobs
from pipeline.jobs.worker import Report
from pipeline.store.atomic_files import write_text
from pipeline.store.errors import StageError
from pipeline.store.run_folder import Identity, RunFolder


@dataclass(frozen=True)
class Toy:
    """What a toy training is given."""

    folder: Path
    steps: int = 3
    seconds_a_step: float = 0.0
    checkpoint_every: int = 1
    fails: str = ""  # "error", "sentence", "refusal", "disk" or "kill"


@pydantic.dataclasses.dataclass
class Fit:
    """Settings of a package, as it checks them."""

    epochs: Annotated[int, Gt(0)] = 1


def train(toy: Toy, report: Report) -> dict[str, Any]:
    """Counts to `steps`; `began` tells at which count this process took it up."""
    toy.folder.mkdir(parents=True, exist_ok=True)
    checkpoint = toy.folder / "checkpoint.json"
    begun = count = json.loads(checkpoint.read_text()) if checkpoint.exists() else 0
    (toy.folder / "started").touch()
    if toy.fails == "error":
        raise ZeroDivisionError("a toy's trouble")
    if toy.fails == "sentence":
        raise StageError("the toy is broken: mend it")
    if toy.fails == "refusal":
        Fit(epochs=-1)
    if toy.fails == "disk":
        raise OSError(errno.ENOSPC, "No space left on device", "weights.pt")
    if toy.fails == "kill":
        os.kill(os.getpid(), 9)
    try:
        while count < toy.steps:
            time.sleep(toy.seconds_a_step)
            count += 1
            if count % toy.checkpoint_every == 0:
                write_text(checkpoint, json.dumps(count))
            report(count / toy.steps, f"count {count}")
    except KeyboardInterrupt:
        write_text(checkpoint, json.dumps(count))
        raise
    return {"began": begun, "count": count, "process": os.getpid(), "threads": os.environ.get("OMP_NUM_THREADS")}


def square(value: int, report: Report) -> int:
    """A job without files."""
    report(0.5)
    return value * value


def opencv_threads(name: str, report: Report) -> int:
    """A job that says how many threads OpenCV would use in it."""
    from guide3d.opencv import cv2

    report(0.5)
    return int(cv2.getNumThreads())


def run_toys(root: Path, names: list[str], steps: int, seconds_a_step: float, checkpoint_every: int) -> None:
    """A stage of toys, for processes that tests start and stop."""
    folder = RunFolder(root, Identity("c", {}, 1))
    with folder.locked():
        folder.prepare()
        toys = {name: Toy(root / name, steps, seconds_a_step, checkpoint_every) for name in names}
        run_jobs(folder, [Job(name, train, toy) for name, toy in toys.items()], workers=2, label="toys")


GB = 1_000_000_000


def gpu(visible: str, free_gb: float) -> Gpu:
    """One of 24 GB, which is not there."""
    return Gpu(visible, "drawn", int(free_gb * GB), 24 * GB)


SECONDS_BESIDE_OTHERS = 1.0  # longer than it takes to start those beside it


def where(seconds: float | None, report: Report) -> Any:
    """Where a job finds itself, and from when to when."""
    began = time.monotonic()
    time.sleep(seconds or 0.0)
    return {"visible": os.environ["CUDA_VISIBLE_DEVICES"], "device": report.device, "time": [began, time.monotonic()]}


def overlap(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether two that `where` told of ran at the same time."""
    return bool(one["time"][0] < other["time"][1] and other["time"][0] < one["time"][1])
