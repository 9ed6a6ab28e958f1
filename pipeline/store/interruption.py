"""Interruption: Ctrl-C stops the work at once, and at the next item when a library swallowed it.

While a package is being imported, a ``KeyboardInterrupt`` may land in a library's ``except`` clause and vanish, or
leave the package half imported; in a finaliser Python prints it and goes on. So it is raised once the import or the
finaliser is over, the signal is remembered, and work made of items looks between them.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from types import FrameType

_AGAIN_S = 0.02
_interrupted = threading.Event()
_again: threading.Timer | None = None  # the signal that is sent once more


def let_ctrl_c_interrupt() -> None:
    """From here on Ctrl-C unwinds the stack, so that temporary files go and the lock is freed."""
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # as nohup and background jobs ask for
        signal.signal(signal.SIGINT, _interrupt)
        sys.unraisablehook = _unraisable


def interrupted() -> bool:
    """Whether Ctrl-C has come since ``let_ctrl_c_interrupt``: an error after it may be its consequence."""
    return _interrupted.is_set()


def stop_if_interrupted() -> None:
    """Stops the work when Ctrl-C came and nothing has come of it.

    Raises:
        KeyboardInterrupt: when the signal has come since ``let_ctrl_c_interrupt``.
    """
    if interrupted():
        raise KeyboardInterrupt


def _interrupt(signum: int, frame: FrameType | None) -> None:
    _interrupted.set()
    if _again is not None:
        _again.cancel()
    if not _importing(frame):
        raise KeyboardInterrupt
    _send_once_more()


def _importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            return True
        frame = frame.f_back
    return False


def _send_once_more() -> None:
    global _again
    _again = threading.Timer(_AGAIN_S, os.kill, (os.getpid(), signal.SIGINT))
    _again.daemon = True
    _again.start()


def _unraisable(error: sys.UnraisableHookArgs) -> None:
    if error.exc_type is KeyboardInterrupt:
        _send_once_more()
    else:
        sys.__unraisablehook__(error)
