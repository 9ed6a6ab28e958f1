"""Cores, memory and GPUs of a machine that stages beside each other share: a file a core, locked while a job is on it.

The lock belongs to the stage whose job it is: when that process ends, however it ends, the kernel frees it.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any

from pipeline.jobs.gpus import Gpu

FOLDER = "ENDONAV_SHARED_MACHINE"  # variable of the environment that names the folder
_ROOM, _GPUS, _TURN, _LOOK = "room_gb", "gpus.json", "turn", "look"


class Core:
    """A core that a job has, until `free` is called; its file says what else the job takes."""

    def __init__(self, lock: IO[str], memory_gb: float) -> None:
        self._lock, self._memory_gb = lock, memory_gb
        self.promise({})

    def promise(self, gpu_bytes: Mapping[str, float]) -> None:
        """Promises the job memory of GPUs, instead of what it was promised before.

        Args:
            gpu_bytes: by what `CUDA_VISIBLE_DEVICES` calls them.
        """
        self._lock.seek(0)
        self._lock.truncate()
        json.dump({"process": os.getpid(), "memory_gb": self._memory_gb, "gpu_bytes": dict(gpu_bytes)}, self._lock)
        self._lock.flush()

    def free(self) -> None:
        """Gives it to the next job, of whichever stage."""
        self._lock.close()


class SharedMachine:
    """What the jobs of several stages share."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._files = folder, sorted(folder.glob("core*"))
        self.room_gb = float((folder / _ROOM).read_text(encoding="utf-8"))

    @classmethod
    def of_environment(cls) -> SharedMachine | None:
        """That of the chain to which this process belongs; None where stages run one after the other."""
        folder = os.environ.get(FOLDER)
        return cls(Path(folder)) if folder and Path(folder, _ROOM).is_file() else None

    def gpus(self, find: Callable[[], Sequence[Gpu]]) -> list[Gpu]:
        """The GPUs and what was free of them before any stage of the chain used one.

        Args:
            find: looks for them; called once a chain.
        """
        with self._locked(_LOOK):
            file = self._folder / _GPUS
            if file.is_file():
                return [Gpu(**entry) for entry in json.loads(file.read_text(encoding="utf-8"))]
            found = list(find())
            file.write_text(json.dumps([asdict(gpu) for gpu in found]), encoding="utf-8")
            return found

    @contextlib.contextmanager
    def turn(self) -> Iterator[None]:
        """Lets no other stage look or take while the body runs, which all that follows needs."""
        with self._locked(_TURN):
            yield

    def take(self, memory_gb: float) -> Core | None:
        """Takes a free core for a job; None while there is none, or while other jobs need the memory.

        Args:
            memory_gb: that the job needs.
        """
        free, busy = self._looked()
        taken_gb = sum(float(job["memory_gb"]) for job in busy)
        core = free.pop() if free and taken_gb + memory_gb <= self.room_gb else None
        for lock in free:
            lock.close()
        return None if core is None else Core(core, memory_gb)

    def gpu_bytes_elsewhere(self) -> dict[str, float]:
        """Memory of each GPU that the jobs of other stages were promised."""
        free, busy = self._looked()
        for lock in free:
            lock.close()
        promised: Counter[str] = Counter()
        for job in busy:
            if job["process"] != os.getpid():
                promised.update(job["gpu_bytes"])
        return dict(promised)

    def _looked(self) -> tuple[list[IO[str]], list[dict[str, Any]]]:
        """Locks of the free cores, and what the jobs on the others take."""
        free: list[IO[str]] = []
        busy: list[dict[str, Any]] = []
        for file in self._files:
            lock = file.open("r+", encoding="utf-8")
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                free.append(lock)
            except BlockingIOError:
                busy.append(json.load(lock))
                lock.close()
        return free, busy

    @contextlib.contextmanager
    def _locked(self, name: str) -> Iterator[None]:
        with (self._folder / name).open("a", encoding="utf-8") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield


@contextlib.contextmanager
def shared_machine(cores: int, room_gb: float) -> Iterator[None]:
    """Has the stages that are started while the body runs share so many cores, so much memory, and the GPUs."""
    with tempfile.TemporaryDirectory(prefix="endonav-machine-") as name:
        folder = Path(name)
        for number in range(cores):
            (folder / f"core{number:04d}").touch()
        (folder / _ROOM).write_text(repr(room_gb), encoding="utf-8")
        os.environ[FOLDER] = name
        try:
            yield
        finally:
            del os.environ[FOLDER]
