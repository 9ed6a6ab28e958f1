"""GPUs: what `stage.device` means, and which GPUs there are.

`auto` is `cuda` where there is a GPU and `cpu` where there is none; `cuda` shares the jobs out among all GPUs that
torch sees, `cuda:1` takes the second one alone. A job's process sees its own GPU and no other, as `cuda`.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from pipeline.store.errors import ConfigurationError, StageError

CPU, CUDA, AUTO = "cpu", "cuda", "auto"
VISIBLE = "CUDA_VISIBLE_DEVICES"
CUDA_CONTEXT_BYTES = 650_000_000  # that a process uses of a GPU before it has any tensor there: on an H100
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
    """The GPUs that torch sees, in its order, with the memory that nobody uses."""
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


def check_device(device: str, find: Callable[[], Sequence[Gpu]] = find_gpus) -> None:
    """Refuses a GPU that there is not."""
    if device in (CPU, AUTO):
        return
    count = len(find())
    if count == 0:
        raise ConfigurationError(
            f"stage.device={device}, but torch finds no GPU: install a build of torch for its CUDA "
            "(docs/installation.md, Which torch), or take cpu or auto"
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
