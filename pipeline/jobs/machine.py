"""What jobs share of this machine: cores, memory and GPUs, those of one stage, or of the stages of a chain.

A chain names a folder in the environment of its stages; what their jobs have is in a file there. What a stage had is
free once its process has ended, however it ended.

`stage.device=auto` is `cuda` where there is a GPU and `cpu` where there is none; `cuda` shares the jobs out among all
GPUs that torch sees, `cuda:1` takes the second one alone. A job's process sees its own GPU and no other, as `cuda`.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

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
    devices = json.loads(looked.stdout.strip().splitlines()[-1])
    return [
        Gpu(names[index] if index < len(names) else str(index), name, int(free), int(total))
        for index, (name, free, total) in enumerate(devices)
    ]


def check_device(device: str) -> None:
    """Refuses a GPU that there is not."""
    if device in (CPU, AUTO):
        return
    count = len(find_gpus())
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


FOLDER = "ENDONAV_SHARED_MACHINE"  # variable of the environment that names the folder
_STATE = "machine.json"
_GB = 1e9


class Machine:
    """What jobs share."""

    def __init__(
        self, cores: int, available_gb: float, gpus: Sequence[Gpu] = (), shared: Path | None = None
    ) -> None:  # fmt: skip
        """So many jobs at the same time, memory and GPUs; `shared`: folder of the chain whose stages share them."""
        self.available_gb, self.gpus, self._shared = available_gb, list(gpus), shared
        self._state: dict[str, Any] = {"cores": cores, "jobs": [], "waiting": {}}

    @classmethod
    def here(cls, cores: int, available: Callable[[], int], device: str) -> Machine:
        """That of this process's chain, or of a stage alone, with `available` bytes."""
        folder = os.environ.get(FOLDER)
        if not folder or not Path(folder, _STATE).is_file():
            return cls(cores, available() / _GB, gpus_of(device, find_gpus() if device != CPU else ()))
        machine = cls(cores, 0.0, shared=Path(folder))
        with machine._locked() as state:
            machine.available_gb = state["available_gb"]
            if device != CPU:
                if state["gpus"] is None:
                    state["gpus"] = [asdict(gpu) for gpu in find_gpus()]
                machine.gpus = gpus_of(device, [Gpu(**gpu) for gpu in state["gpus"]])
        return machine

    def check(self, job: Any) -> None:
        """Refuses a `pipeline.jobs.worker.Job` that would wait for ever."""
        most = max((gpu.free_bytes for gpu in self.gpus), default=0) / _GB
        if self.gpus and most < job.gpu_gb:
            raise StageError(
                f"{job.key} needs a GPU with about {job.gpu_gb:.1f} GB free, the most is {most:.1f} GB: free memory "
                "there, or set stage.device=cpu"
            )
        if job.memory_gb > self.available_gb:
            raise StageError(
                f"{job.key} needs about {job.memory_gb:.1f} GB of memory, {self.available_gb:.1f} GB are available: "
                "end other programs, or make it smaller (stage.decisions or the side of the images, for a training)"
            )

    def take(self, job: Any) -> tuple[Gpu, ...] | None:
        """Gives a job a core, memory, and the GPU with most memory free (() for none); None: one is missing."""
        with self._locked() as state:
            others, own = state["jobs"], str(os.getpid())
            left_gb = self.available_gb - sum(other["memory_gb"] for other in others)
            has_memory, has_core = job.memory_gb <= left_gb, len(others) < state["cores"]
            may_start = has_memory and has_core and not self._another_comes_first(state, left_gb)
            state["waiting"].pop(own, None)
            if not may_start:
                if has_memory:
                    state["waiting"][own] = job.memory_gb
                return None
            gpus = self._with_free_memory(job, others)
            if gpus is not None:
                promised = {gpu.visible: job.gpu_gb * _GB for gpu in gpus}
                others.append({"owner": own, "key": job.key, "memory_gb": job.memory_gb, "gpu_bytes": promised})
            return gpus

    @staticmethod
    def _another_comes_first(state: dict[str, Any], left_gb: float) -> bool:
        """Whether a stage with fewer jobs under way waits for a core, and has the memory."""
        owners = [job["owner"] for job in state["jobs"]]
        mine = owners.count(str(os.getpid()))
        return any(owners.count(owner) < mine and gb <= left_gb for owner, gb in state["waiting"].items())

    def _with_free_memory(self, job: Any, others: Sequence[dict[str, Any]]) -> tuple[Gpu, ...] | None:
        if not (self.gpus and job.gpu_gb):
            return ()
        free_bytes = {
            gpu: gpu.free_bytes - sum(other["gpu_bytes"].get(gpu.visible, 0.0) for other in others) for gpu in self.gpus
        }
        chosen = max(self.gpus, key=lambda gpu: free_bytes[gpu])
        return (chosen,) if free_bytes[chosen] >= job.gpu_gb * _GB else None

    def measured(self, key: str, bytes_used: int) -> None:
        """Takes note of what a job really uses of each of its GPUs, where that is more than it was promised."""
        with self._locked() as state:
            for job in self._of(state, key):
                job["gpu_bytes"] = {name: max(promised, bytes_used) for name, promised in job["gpu_bytes"].items()}

    def free(self, key: str) -> None:
        """A job has ended."""
        with self._locked() as state:
            for job in self._of(state, key):
                state["jobs"].remove(job)

    @staticmethod
    def _of(state: dict[str, Any], key: str) -> list[dict[str, Any]]:
        return [job for job in state["jobs"] if (job["owner"], job["key"]) == (str(os.getpid()), key)]

    @contextlib.contextmanager
    def _locked(self) -> Iterator[dict[str, Any]]:
        """What jobs have, to be read and changed while no other stage does."""
        if self._shared is None:
            yield self._state
            return
        with (self._shared / "lock").open("a") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            text = (self._shared / _STATE).read_text("utf-8")
            state = json.loads(text)
            state["jobs"] = [job for job in state["jobs"] if _lives(job["owner"])]
            state["waiting"] = {owner: gb for owner, gb in state["waiting"].items() if _lives(owner)}
            yield state
            if (changed := json.dumps(state)) != text:
                (self._shared / "new").write_text(changed, "utf-8")
                os.replace(self._shared / "new", self._shared / _STATE)


def _lives(owner: str) -> bool:
    try:
        os.kill(int(owner), 0)
    except OSError:
        return False
    return True


@contextlib.contextmanager
def shared_machine(cores: int, available_gb: float) -> Iterator[None]:
    """Has the stages that are started while the body runs share so many cores, so much memory, and the GPUs."""
    with tempfile.TemporaryDirectory(prefix="endonav-machine-") as name:
        state: dict[str, Any] = {"cores": cores, "available_gb": available_gb, "gpus": None, "jobs": [], "waiting": {}}
        Path(name, _STATE).write_text(json.dumps(state), "utf-8")
        os.environ[FOLDER] = name
        try:
            yield
        finally:
            del os.environ[FOLDER]
