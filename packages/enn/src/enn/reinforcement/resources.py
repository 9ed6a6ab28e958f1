"""What a training takes of its machine: threads that share work with the one that asks for it, and memory.

Native simulators release the interpreter's lock.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

_LIMIT = Path("/sys/fs/cgroup/memory.max")
_USED = Path("/sys/fs/cgroup/memory.current")
_INFO = Path("/proc/meminfo")


class Workers:
    """Threads for independent pieces of work; results do not depend on how many there are.

    Args:
        threads: with the one that asks.
    """

    def __init__(self, threads: int = 1) -> None:
        self._helpers = threads - 1
        self._pool = ThreadPoolExecutor(self._helpers, "enn") if self._helpers > 0 else None

    def begin(self, work: Callable[[int], Any], indices: Sequence[int]) -> SharedWork:
        """Lets the helpers begin; who asks does the rest in `SharedWork.finish`."""
        return SharedWork(work, indices, self._pool, self._helpers if len(indices) > 1 else 0)

    def each(self, work: Callable[[int], Any], indices: Sequence[int]) -> list[Any]:
        """The results of work on indices, in their order."""
        return self.begin(work, indices).finish()

    def close(self) -> None:
        """Ends the threads once they have done what they had begun."""
        if self._pool is not None:
            self._pool.shutdown()


class SharedWork:
    """Work on indices that helpers have begun with."""

    def __init__(
        self, work: Callable[[int], Any], indices: Sequence[int], pool: ThreadPoolExecutor | None, helpers: int
    ) -> None:
        self._work, self._indices, self._queue = work, indices, iter(indices)
        self._results: dict[int, Any] = {}
        self._helpers = [] if pool is None else [pool.submit(self._run) for _ in range(helpers)]

    def _run(self) -> None:
        for index in self._queue:
            self._results[index] = self._work(index)

    def finish(self) -> list[Any]:
        """Does what is left, and returns the results in the order of the indices.

        Raises:
            Exception: what the work raised, after the helpers have ended theirs.
        """
        try:
            self._run()
        finally:
            for helper in self._helpers:
                helper.result()
        return [self._results[index] for index in self._indices]


def available_bytes() -> int:
    """Bytes available without swapping: the machine's, or what a container's limit leaves, whichever is less."""
    free = _machine()
    try:
        limit = _LIMIT.read_text(encoding="utf-8").strip()
        if limit != "max":
            free = min(free, max(int(limit) - int(_USED.read_text(encoding="utf-8")), 0))
    except (OSError, ValueError):
        pass  # no control groups here
    return free


def trim_heap() -> None:
    """Gives the free pages inside the heap back to the system, where its C library does not do so by itself (glibc).

    A training over many anatomies otherwise grows beyond what it holds: 8 GB instead of 12 and more in 150 arches.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if os.name == "posix" else None
    if trim is not None:
        trim(ctypes.c_size_t(0))


def _machine() -> int:
    try:
        for line in _INFO.read_text(encoding="utf-8").splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except (OSError, ValueError):
        pass  # not Linux: what is installed is all that can be known
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
