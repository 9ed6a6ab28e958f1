"""Workers: threads that share work with the one that asks for it; native simulators release the interpreter's lock."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any


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
