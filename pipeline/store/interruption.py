"""Interruption: Ctrl-C stops the work at once, and at the next item when a library swallowed it.

While a package is being imported, a ``KeyboardInterrupt`` may land in a library's ``except`` clause and vanish. So the
signal is remembered, and work made of items looks between them.
"""

from __future__ import annotations

import signal
import threading
from types import FrameType

_interrupted = threading.Event()


def let_ctrl_c_interrupt() -> None:
    """From here on Ctrl-C unwinds the stack, so that temporary files go and the lock is freed."""
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # as nohup and background jobs ask for
        signal.signal(signal.SIGINT, _interrupt)


def stop_if_interrupted() -> None:
    """Stops the work when Ctrl-C came and nothing has come of it.

    Raises:
        KeyboardInterrupt: when the signal has come since ``let_ctrl_c_interrupt``.
    """
    if _interrupted.is_set():
        raise KeyboardInterrupt


def _interrupt(signum: int, frame: FrameType | None) -> None:
    _interrupted.set()
    raise KeyboardInterrupt
