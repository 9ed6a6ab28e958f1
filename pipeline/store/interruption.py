"""Interruption: Ctrl-C and SIGTERM stop the work at once, or at the next item when a library swallowed them.

What a signal raises may land in a library's ``except`` clause and vanish, leave a package half imported, or come in a
finaliser, where Python goes on. So both are remembered: work made of items looks between them, and an error that comes
after a signal is its consequence.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from multiprocessing import parent_process
from types import FrameType

_SECONDS_TO_END = 10.0  # that what a process runs has after the process that started it has ended
_came: list[int] = []  # signals since the functions below were called


def let_ctrl_c_interrupt() -> None:
    """From here on Ctrl-C unwinds the stack, so that temporary files go and the lock is freed."""
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # as nohup and background jobs ask for
        _unwind_at(signal.SIGINT)


def let_sigterm_exit() -> None:
    """From here on SIGTERM unwinds the stack, too, and the process ends with 143."""
    _unwind_at(signal.SIGTERM)


def _unwind_at(number: signal.Signals) -> None:
    signal.signal(number, _interrupt)
    sys.unraisablehook = _unraisable


def interrupted() -> int:
    """The exit code of Ctrl-C or SIGTERM once one has come, else 0: an error after it may be its consequence."""
    return 128 + _came[-1] if _came else 0


def stop_if_interrupted() -> None:
    """Raises what a signal has raised when nothing has come of it."""
    if _came:
        raise _exception(_came[-1])


def _exception(number: int) -> BaseException:
    return KeyboardInterrupt() if number == signal.SIGINT else SystemExit(128 + number)


def _interrupt(number: int, frame: FrameType | None) -> None:
    _came.append(number)
    raise _exception(number)


def _unraisable(error: sys.UnraisableHookArgs) -> None:
    if not (interrupted() and isinstance(error.exc_value, KeyboardInterrupt | SystemExit)):
        sys.__unraisablehook__(error)


def end_with_parent() -> None:
    """Lets a pool's process end when its parent ends it or was killed, and first what it runs itself."""
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))

    def watch() -> None:
        if parent := parent_process():
            parent.join()
            for _ in range(10):  # a pool takes each for the end of a case, and begins what waits in its queue
                os.kill(os.getpid(), signal.SIGTERM)
                time.sleep(_SECONDS_TO_END / 10)
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


EXIT_INTERRUPTED = 130
INTERRUPTED = "interrupted: what is finished is kept; the same command goes on from there"


def stop_at_once_by_ctrl_c() -> None:
    """Lets Ctrl-C end the program until it has a handler of its own: nothing is written before."""
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # as nohup and background jobs ask for
        signal.signal(signal.SIGINT, _stop)


def _stop(signum: int, frame: FrameType | None) -> None:
    os.write(2, f"{INTERRUPTED}\n".encode())
    os._exit(EXIT_INTERRUPTED)
