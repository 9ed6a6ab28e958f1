"""Cores and memory of one machine that stages beside each other share: a file a core, locked while a job is on it.

The lock belongs to the stage whose job it is: when that process ends, however it ends, the kernel frees it.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO

FOLDER = "ENDONAV_SHARED_CORES"  # variable of the environment that names the folder
_ROOM = "room_gb"


class Core:
    """A core that a job has, until `free` is called."""

    def __init__(self, lock: IO[str]) -> None:
        self._lock = lock

    def free(self) -> None:
        """Gives it to the next job, of whichever stage."""
        self._lock.close()


class SharedCores:
    """The cores that the jobs of several stages share."""

    def __init__(self, folder: Path) -> None:
        self._files = sorted(folder.glob("core*"))
        self.room_gb = float((folder / _ROOM).read_text(encoding="utf-8"))

    @classmethod
    def of_environment(cls) -> SharedCores | None:
        """Those of the chain that this process belongs to; None where stages run one after the other."""
        folder = os.environ.get(FOLDER)
        return cls(Path(folder)) if folder and Path(folder, _ROOM).is_file() else None

    def take(self, memory_gb: float) -> Core | None:
        """Takes a free core for a job; None while there is none, or while other jobs need the memory.

        Args:
            memory_gb: that the job needs.
        """
        taken_gb, free = 0.0, []
        for file in self._files:
            lock = file.open("r+", encoding="utf-8")
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                free.append(lock)
            except BlockingIOError:
                taken_gb += float(lock.read() or 0.0)
                lock.close()
        core = free.pop() if free and taken_gb + memory_gb <= self.room_gb else None
        for lock in free:
            lock.close()
        if core is None:
            return None
        core.truncate(0)
        core.write(f"{memory_gb:.3f}")
        core.flush()
        return Core(core)


@contextlib.contextmanager
def shared_cores(count: int, room_gb: float) -> Iterator[None]:
    """Has the stages that are started while the body runs share so many cores, and so much memory."""
    with tempfile.TemporaryDirectory(prefix="endonav-cores-") as name:
        folder = Path(name)
        for number in range(count):
            (folder / f"core{number:04d}").touch()
        (folder / _ROOM).write_text(repr(room_gb), encoding="utf-8")
        os.environ[FOLDER] = name
        try:
            yield
        finally:
            del os.environ[FOLDER]
