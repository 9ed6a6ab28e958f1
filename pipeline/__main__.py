"""Command line of the stages: ``python -m pipeline stage=phantoms``; ``--help`` lists stages and budgets."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType

_EXIT_INTERRUPTED = 130


def _stop_at_once(signum: int, frame: FrameType | None) -> None:
    """Ends the program: while it starts nothing is written, and libraries could swallow a KeyboardInterrupt."""
    os.write(2, b"interrupted before the work began\n")
    os._exit(_EXIT_INTERRUPTED)


if __name__ == "__main__":
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # as nohup and background jobs ask for
        signal.signal(signal.SIGINT, _stop_at_once)
    from pipeline.launch import main

    sys.exit(main(sys.argv[1:]))
