"""Cores, memory and GPUs of a machine that stages beside each other share: a file a core, locked while a job is on it.

The lock belongs to the stage whose job it is: when that process ends, however it ends, the kernel frees it. A stage
that waits for a core holds another file locked, so that none with more jobs under way takes the next one before it.
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
_ROOM, _GPUS, _TURN, _LOOK, _WAITING = "room_gb", "gpus.json", "turn", "look", "waiting-"


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
        self._waits: IO[str] | None = None  # the lock of a stage that waits for a core
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
        """Takes a free core for a job; None while there is none, or another stage is due, or jobs need the memory.

        Args:
            memory_gb: that the job needs.
        """
        free, busy = self._looked()
        left_gb = self.room_gb - sum(float(job["memory_gb"]) for job in busy)
        has_memory = memory_gb <= left_gb
        core = free.pop() if free and has_memory and not self._another_is_due(busy, left_gb) else None
        for lock in free:
            lock.close()
        self._wait(memory_gb if has_memory and core is None else None)
        return None if core is None else Core(core, memory_gb)

    def _another_is_due(self, busy: Sequence[Mapping[str, Any]], left_gb: float) -> bool:
        """Whether a stage with fewer jobs under way waits for a core, and has the memory."""
        jobs = Counter(job["process"] for job in busy)
        for file in self._folder.glob(f"{_WAITING}*"):
            process = int(file.name.removeprefix(_WAITING))
            if process == os.getpid():
                continue
            with file.open("r+", encoding="utf-8") as lock:
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # then that stage has ended
                except BlockingIOError:
                    if jobs[process] < jobs[os.getpid()] and float(lock.read()) <= left_gb:
                        return True
        return False

    def _wait(self, memory_gb: float | None) -> None:
        """Says to the others that this stage waits for a core, for a job with so much memory; None: it does not."""
        file = self._folder / f"{_WAITING}{os.getpid()}"
        if self._waits is not None:
            file.unlink(missing_ok=True)
            self._waits.close()
            self._waits = None
        if memory_gb is not None:
            self._waits = file.open("w", encoding="utf-8")
            fcntl.flock(self._waits, fcntl.LOCK_EX)
            self._waits.write(repr(memory_gb))
            self._waits.flush()

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
