"""Starts the process that carries a job on the machine that a cluster has chosen for it.

Runs there with the standard library alone, possibly where nothing else of the project can be imported: Ray sends it by
value.
"""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
from dataclasses import dataclass
from multiprocessing import Pipe
from pathlib import Path

CARRIER = "pipeline.jobs.engines.carrier"


@dataclass(frozen=True)
class Order:
    """What a carrier is asked to do."""

    attempt: Path  # folder of this attempt
    token: str  # of the driver
    notes: tuple[Path, Path]  # the stage's folder, and the file where the job's files below it are noted
    job: bytes  # the pickled function and what it is given
    gpu: bool  # whether the job computes on the GPUs that the cluster has given this process
    lease_s: float  # that it works on without a sign of its driver


@dataclass(frozen=True)
class Errand:
    """A job that is sent out, as plain values."""

    attempt: str  # folder of this attempt, which all machines must see
    python: str  # the interpreter
    cwd: str  # the driver's working directory
    environment: dict[str, str]  # variables that the job needs
    order: bytes  # a pickled `Order`


def unseen(*paths: str) -> str | None:
    """The first of some paths that this machine does not have; None when it has all."""
    return next((path for path in paths if not os.path.exists(path)), None)


def run_errand(attempt: str, python: str, cwd: str, environment: dict[str, str], order: bytes) -> str | None:
    """Runs a job in a process of its own, which ends with this one, and waits for it.

    Args:
        attempt: its folder.
        python: the interpreter.
        cwd: where the driver works.
        environment: variables beside those of this machine.
        order: a pickled `Order`.

    Returns:
        Why it could not start; None: it did, and says the rest in the files of its attempt.
    """
    missing = unseen(attempt, python, cwd)
    if missing is not None:
        return (
            f"machine {socket.gethostname()} does not see {missing}: put the project, its environment and runs_dir "
            "on a file system that all machines share"
        )
    ours, theirs = Pipe()
    with open(os.path.join(attempt, "output.txt"), "ab") as output:
        process = subprocess.Popen(
            [python, "-m", CARRIER, str(theirs.fileno())],
            cwd=cwd, env={**os.environ, **environment}, pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL, stdout=output, stderr=output,
        )  # fmt: skip
    theirs.close()
    with contextlib.suppress(OSError):  # it has ended already, and its exit code says how
        ours.send_bytes(order)
    code = process.wait()
    ours.close()
    return None if code == 0 else f"the job's process ended with code {code}: see {attempt}/output.txt"
