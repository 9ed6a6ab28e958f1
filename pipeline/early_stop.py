"""Ctrl-C while a program starts: it ends at once with a sentence, as libraries could swallow a KeyboardInterrupt."""

from __future__ import annotations

import os
import signal
from types import FrameType

EXIT_INTERRUPTED = 130
INTERRUPTED = "interrupted: what is finished is kept; the same command goes on from there"


def stop_at_once_by_ctrl_c() -> None:
    """Lets Ctrl-C end the program until it has a handler of its own: nothing is written before."""
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # as nohup and background jobs ask for
        signal.signal(signal.SIGINT, _stop)


def _stop(signum: int, frame: FrameType | None) -> None:
    os.write(2, f"{INTERRUPTED}\n".encode())
    os._exit(EXIT_INTERRUPTED)
