"""The loop's inbox: requests of other threads, of each kind only the latest, so that no flood fills memory."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable

Work = Callable[[], None]


class Inbox:
    """Hands work to the loop's thread.

    What is asked for twice before the loop comes to it is done once, as it was asked for last: a page that sends a
    thousand wishes to restart gets one. The controls do not come this way: see `ControlPanel`.
    """

    def __init__(self) -> None:
        self._filled = threading.Condition()
        self._waiting: OrderedDict[str, Work | None] = OrderedDict()

    def put(self, kind: str, work: Work | None = None) -> None:
        """Asks the loop for work (None only wakes it up); a newer one replaces an older one of the same kind."""
        with self._filled:
            self._waiting.pop(kind, None)
            self._waiting[kind] = work
            self._filled.notify()

    def get(self, timeout_s: float) -> tuple[str, Work | None] | None:
        """The kind and the work that waits for longest, after at most `timeout_s`; None when there was nothing."""
        with self._filled:
            if not self._waiting:
                self._filled.wait(max(timeout_s, 0.0))
            return self._waiting.popitem(last=False) if self._waiting else None

    def __len__(self) -> int:
        """How many wait: never more than there are kinds."""
        with self._filled:
            return len(self._waiting)
