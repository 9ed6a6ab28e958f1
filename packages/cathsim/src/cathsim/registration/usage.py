"""One environment is used by one thread at a time, and not after it was closed: everything else is a sentence.

The native code steps without the interpreter's lock, so that two threads in one simulation would end the process.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from typing import Any, TypeVar

Method = TypeVar("Method", bound=Callable[..., Any])


class Usage:
    """Who uses an environment; a copy of the environment has one of its own.

    Attributes:
        closed: whether the environment was closed.
    """

    def __init__(self, closed: bool = False) -> None:
        self.closed = closed
        self._lock = threading.RLock()

    def __reduce__(self) -> tuple[type[Usage], tuple[bool]]:
        return Usage, (self.closed,)

    def __enter__(self) -> None:
        if not self._lock.acquire(blocking=False):
            raise RuntimeError(
                "another thread is using this environment: make one for each thread, or many with "
                "cathsim.ThreadedVectorEnv"
            )
        if self.closed:
            self._lock.release()
            raise RuntimeError("the environment is closed: make it again")

    def __exit__(self, *unused: object) -> None:
        self._lock.release()

    def close(self, free: Callable[[], None]) -> None:
        """Closes the environment, which `free` does; closing it again does nothing."""
        if not self.closed:
            with self:
                free()
                self.closed = True


def exclusive(method: Method) -> Method:
    """Refuses a method of an environment, which has a `usage`, to a second thread and after the end.

    Raises:
        RuntimeError: another thread is in such a method, or the environment is closed.
    """

    @functools.wraps(method)
    def guarded(self: Any, *args: Any, **kwargs: Any) -> Any:
        with self.usage:
            return method(self, *args, **kwargs)

    return guarded  # type: ignore[return-value]
