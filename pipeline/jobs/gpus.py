"""GPUs: the one place that knows what `stage.device` means, which GPUs there are, and which job computes on which.

`auto` is `cuda` where there is a GPU and `cpu` where there is none; `cuda` shares the jobs out among all GPUs that
torch sees, `cuda:1` takes the second one alone. A job's process sees its own GPU and no other, as `cuda`.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pipeline.store.errors import ConfigurationError, StageError

CPU, CUDA, AUTO = "cpu", "cuda", "auto"
VISIBLE = "CUDA_VISIBLE_DEVICES"
CUDA_CONTEXT_BYTES = 650_000_000  # that a process uses of a GPU before it has any tensor there: on an H100
_GB = 1e9
_SECONDS_TO_LOOK = 120.0
# In a process of its own, which ends: whoever asks a GPU for its memory keeps some of it for as long as it lives.
_LOOK = """
import json, torch
count = torch.cuda.device_count() if torch.cuda.is_available() else 0
print(json.dumps([[torch.cuda.get_device_name(k), *torch.cuda.mem_get_info(k)] for k in range(count)]))
"""


@dataclass(frozen=True)
class Gpu:
    """A GPU."""

    visible: str  # what `CUDA_VISIBLE_DEVICES` calls it
    name: str
    free_bytes: int  # of its memory when the stage looked
    total_bytes: int  # of its memory


def find_gpus() -> list[Gpu]:
    """The GPUs that torch sees, in its order, with the memory that nobody uses.

    Raises:
        StageError: torch fails when it looks for them.
    """
    looked = subprocess.run(
        [sys.executable, "-c", _LOOK], capture_output=True, text=True, timeout=_SECONDS_TO_LOOK, check=False
    )
    if looked.returncode:
        lines = looked.stderr.strip().splitlines()
        raise StageError(f"torch cannot look for GPUs: {lines[-1] if lines else 'no word of why'}")
    names = [name.strip() for name in os.environ.get(VISIBLE, "").split(",") if name.strip()]
    found = json.loads(looked.stdout.strip().splitlines()[-1])
    return [
        Gpu(names[index] if index < len(names) else str(index), name, int(free), int(total))
        for index, (name, free, total) in enumerate(found)
    ]


def check_device(device: str) -> None:
    """Refuses a GPU that there is not.

    Raises:
        ConfigurationError: torch sees no GPU, or not so many.
    """
    if device in (CPU, AUTO):
        return
    import torch

    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if count == 0:
        raise ConfigurationError(
            f"stage.device={device}, but torch finds no GPU: install a build of torch for its CUDA "
            "(docs/getting_started.md, With a GPU), or take cpu or auto"
        )
    if _index(device) >= count:
        raise ConfigurationError(
            f"stage.device={device}, but torch finds {count} GPU{'s' if count > 1 else ''}: the last is "
            f"cuda:{count - 1}"
        )


def gpus_of(device: str, found: Sequence[Gpu]) -> list[Gpu]:
    """Those of the GPUs there are that a setting allows."""
    if device == CPU:
        return []
    return [found[_index(device)]] if ":" in device else list(found)


def _index(device: str) -> int:
    return int(device.partition(":")[2] or 0)


class GpuShare:
    """Which job computes on which GPUs, and how much of their memory is promised."""

    def __init__(self, gpus: Sequence[Gpu]) -> None:
        self.gpus = list(gpus)
        self._promised: dict[str, tuple[tuple[int, ...], float]] = {}  # key to GPUs and bytes on each

    def require_room(self, key: str, gigabytes: float, count: int = 1) -> None:
        """Refuses a job that would wait for ever.

        Args:
            gigabytes: of memory that it needs on each GPU.

        Raises:
            StageError: there are fewer GPUs, or they have less memory free.
        """
        wide = sum(gpu.free_bytes >= gigabytes * _GB for gpu in self.gpus)
        if wide >= count:
            return
        most = max(gpu.free_bytes for gpu in self.gpus) / _GB
        raise StageError(
            f"{key} needs {count} GPU{'s' if count > 1 else ''} with about {gigabytes:.1f} GB free, of "
            f"{len(self.gpus)} {wide} have so much, {most:.1f} GB the most: free memory there, or set stage.device=cpu"
        )

    def take(
        self, key: str, gigabytes: float, count: int = 1, elsewhere: Mapping[str, float] | None = None
    ) -> tuple[Gpu, ...] | None:
        """Promises a job memory on the GPUs with the most room.

        Args:
            gigabytes: on each.
            elsewhere: bytes of GPUs that jobs of other stages were promised, by `Gpu.visible`.

        Returns:
            The GPUs; None while there is no room.
        """
        others = elsewhere or {}
        room = [self.room(index) - others.get(gpu.visible, 0.0) for index, gpu in enumerate(self.gpus)]
        chosen = tuple(sorted(range(len(room)), key=lambda index: (-room[index], index))[:count])
        if len(chosen) < count or any(room[index] < gigabytes * _GB for index in chosen):
            return None
        self._promised[key] = chosen, gigabytes * _GB
        return tuple(self.gpus[index] for index in chosen)

    def measured(self, key: str, bytes_used: int) -> None:
        """Takes note of what a job really uses of each GPU, where that is more than it was promised."""
        chosen, promised = self._promised[key]
        self._promised[key] = chosen, max(promised, float(bytes_used))

    def promised(self, key: str) -> dict[str, float]:
        """Bytes of each of a job's GPUs, by `Gpu.visible`; none for a job that has none."""
        chosen, promised = self._promised.get(key, ((), 0.0))
        return {self.gpus[index].visible: promised for index in chosen}

    def give_back(self, key: str) -> None:
        """A job has ended."""
        self._promised.pop(key, None)

    def room(self, index: int) -> float:
        """Bytes of a GPU that are promised to nobody."""
        return self.gpus[index].free_bytes - sum(
            promised for chosen, promised in self._promised.values() if index in chosen
        )
