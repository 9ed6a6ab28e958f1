"""Runs targets in processes of their own, one after the other, and watches CPU time and memory of every seed."""

from __future__ import annotations

import logging
import multiprocessing
import resource
import time
import traceback
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tests.fuzz.target import Target

SECONDS_TO_PREPARE = 180.0
WALL_SECONDS_A_SECOND = 6  # of CPU time that a seed may take, before it counts as one that hangs
MOST_FAILURES = 20  # of a target: the first ones tell enough


@dataclass
class Tally:
    """What came of a target."""

    cases: int = 0
    seeds: int = 0
    seconds: float = 0.0
    slowest_s: float = 0.0
    verdicts: Counter[str] = field(default_factory=Counter)
    failures: list[dict[str, Any]] = field(default_factory=list)

    def to_json(self) -> dict[str, Any]:
        """Plain values, with the verdicts as columns."""
        verdicts = {name: self.verdicts[name] for name in ("refused", "equal", "accepted")}
        times = {"seconds": round(self.seconds, 1), "slowest_s": round(self.slowest_s, 3)}
        return {"cases": self.cases, "seeds": self.seeds, **verdicts, **times, "failures": self.failures}


def run_target(kind: type[Target], first: int, *, seconds: float, seeds: Sequence[int] | None = None) -> Tally:
    """Runs a target until its time is over, or over given seeds.

    Args:
        kind: of target.
        first: seed; the others follow.
        seconds: for all of them.
        seeds: to run instead, each once.
    """
    tally, began = Tally(), time.monotonic()
    waiting = None if seeds is None else list(seeds)
    seed = first
    while (waiting is None or waiting) and len(tally.failures) < MOST_FAILURES:
        left = seconds - (time.monotonic() - began)
        if left <= 0:
            break
        with TemporaryDirectory(prefix=f"fuzz-{kind.name}-") as folder:
            seed, prepared = _watch(kind, Path(folder), seed, tally, seconds=left, seeds=waiting)
            began += prepared  # what is prepared costs no time of the cases
    tally.seconds = time.monotonic() - began
    return tally


def _watch(
    kind: type[Target], folder: Path, seed: int, tally: Tally, *, seconds: float, seeds: list[int] | None
) -> tuple[int, float]:
    """Feeds a process with seeds until the time is over or a seed ends it; the next one, and the seconds to prepare."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(kind, folder, theirs), daemon=True)
    started = time.monotonic()
    process.start()
    theirs.close()
    prepared = 0.0
    try:
        if not ours.poll(SECONDS_TO_PREPARE) or ours.recv() != "ready":
            tally.failures.append(_failure(kind, seed, "the target could not be prepared", ""))
            return seed + 1, 0.0
        prepared = time.monotonic() - started
        until = time.monotonic() + seconds
        while time.monotonic() < until and (seeds is None or seeds):
            current = seed if seeds is None else seeds.pop(0)
            began = time.monotonic()
            ours.send(current)
            seed = current + 1
            answer: dict[str, Any] | None = None
            try:
                # one that hangs is ended with its process; other work on the machine is no fault of it
                hangs = WALL_SECONDS_A_SECOND * kind.seconds
                answer = ours.recv() if ours.poll(hangs) else {"problem": f"over {hangs:g} s"}
            except EOFError:
                answer = {"problem": "its process died"}
            took = answer.get("cpu_s", time.monotonic() - began)
            tally.seeds += 1
            tally.slowest_s = max(tally.slowest_s, took)
            counts = Counter(answer.get("counts", {}))
            tally.verdicts += counts
            tally.cases += max(sum(counts.values()), 1)
            problem = answer["problem"]
            if not problem and took > kind.seconds:
                problem = f"{took:.1f} s of CPU time, at most {kind.seconds:g} s are allowed"
            if problem:
                tally.failures.append(_failure(kind, current, problem, answer.get("where", "")))
            if answer.get("counts") is None:
                return seed, prepared  # with a fresh process
            if len(tally.failures) >= MOST_FAILURES:
                break
    finally:
        process.kill()
        process.join()
        ours.close()
    return seed, prepared


def _failure(kind: type[Target], seed: int, problem: str, where: str) -> dict[str, Any]:
    command = f"python -m tests.fuzz --only {kind.name} --case {seed}"
    return {"seed": seed, "problem": problem, "where": where, "reproduce": command}


def _work(kind: type[Target], folder: Path, connection: Connection) -> None:
    logging.disable(logging.CRITICAL)  # what is left out is told thousands of times
    target = kind(folder)
    connection.send("ready")
    while True:
        seed = connection.recv()
        target.counts.clear()
        before, cpu = _peak_mb(), time.process_time()
        problem = where = ""
        try:
            target.run(seed)
        except Exception as error:  # whatever it is, it is not the promised error
            lines = str(error).strip().splitlines() or [""]
            problem = f"{type(error).__name__}: {lines[0][:500]}"
            frames = traceback.extract_tb(error.__traceback__)[-4:]
            where = " < ".join(f"{Path(frame.filename).name}:{frame.lineno} {frame.name}" for frame in frames[::-1])
        grown = _peak_mb() - before
        if not problem and grown > target.megabytes:
            problem = f"{grown:.0f} MB more, at most {target.megabytes} MB are allowed"
        spent = time.process_time() - cpu
        connection.send({"counts": dict(target.counts), "problem": problem, "where": where, "cpu_s": spent})


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
