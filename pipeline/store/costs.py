"""What a job has cost: time, memory, and memory of a GPU, kept in the manifest of its stage."""

from __future__ import annotations

import os
import resource
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pipeline.store.atomic_files import read_json, write_json

COSTS = ".costs"  # folder of a stage under way; the manifest takes it over
_FILE = "jobs.json"
_MB = 1e6
_RSS_UNIT = 1 if sys.platform == "darwin" else 1024  # bytes
OK = "ok"
OWN_PROCESS = ""  # key of the stage's own process


@dataclass(frozen=True)
class Cost:
    """Of a job, in its own process."""

    wall_s: float  # from its start to its end
    cpu_s: float  # of all its threads, and of the processes that it started and that have ended
    # the most that its process had in memory, what was imported before included, and the largest of those
    memory_mb: float
    gpu_mb: float  # the most that torch had allocated on a GPU; 0: it used none
    device: str  # "cpu", or the name of the GPU
    outcome: str = OK  # "ok", or why the job failed


class CostMeter:
    """Measures this process from here on."""

    def __init__(self) -> None:
        self._began, self._worked = time.monotonic(), processor_s()

    def read(self, outcome: str = OK) -> Cost:
        """What the job has cost so far."""
        gpu_bytes, device = _gpu()
        peak = sum(resource.getrusage(whose).ru_maxrss for whose in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
        return Cost(
            wall_s=round(time.monotonic() - self._began, 3),
            cpu_s=round(processor_s() - self._worked, 3),
            memory_mb=round(peak * _RSS_UNIT / _MB, 1),
            gpu_mb=round(gpu_bytes / _MB, 1),
            device=device,
            outcome=outcome,
        )


def processor_s() -> float:
    """Processor time of this process so far, and of those that it started and that have ended, s."""
    return sum(os.times()[:4])


def _gpu() -> tuple[int, str]:
    torch: Any = sys.modules.get("torch")
    if torch is None or not torch.cuda.is_initialized():
        return 0, "cpu"
    return int(torch.cuda.max_memory_allocated()), str(torch.cuda.get_device_name())


def keep_cost(folder: Path, key: str, cost: Cost) -> None:
    """Adds a job's cost to its stage's, which an interrupted stage finds again."""
    write_json(folder / COSTS / _FILE, {**kept_costs(folder), key: asdict(cost)})


def kept_costs(folder: Path) -> dict[str, dict[str, Any]]:
    """Costs of the jobs that have ended in a stage under way, by their keys; a damaged file counts as none."""
    try:
        costs = read_json(folder / COSTS / _FILE)
    except (FileNotFoundError, ValueError):
        return {}
    return costs if isinstance(costs, dict) else {}
