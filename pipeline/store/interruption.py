"""Interruption: Ctrl-C and SIGTERM stop the work at once, Ctrl-C at the next item when a library swallowed it.

While a package is being imported, what a signal raises may land in a library's ``except`` clause and vanish, or leave
the package half imported; in a finaliser Python prints it and goes on. So it is raised once the import or the finaliser
is over. Ctrl-C is remembered, and work made of items looks between them.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from multiprocessing import parent_process
from types import FrameType

_AGAIN_S = 0.02
_SECONDS_TO_END = 10.0  # that what a process runs has after the process that started it has ended
_interrupted = threading.Event()
_held_back = [signal.SIGINT]  # the signal that is sent again when an import or a finaliser is over
EXIT_TERMINATED = 128 + signal.SIGTERM


def let_ctrl_c_interrupt() -> None:
    """From here on Ctrl-C unwinds the stack, so that temporary files go and the lock is freed."""
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # as nohup and background jobs ask for
        _unwind_at(signal.SIGINT)


def let_sigterm_exit() -> None:
    """From here on SIGTERM unwinds the stack, too, and the process ends with 143."""
    _unwind_at(signal.SIGTERM)


def _unwind_at(number: signal.Signals) -> None:
    signal.signal(number, _interrupt)
    signal.signal(signal.SIGALRM, _send_again)
    sys.unraisablehook = _unraisable


def interrupted() -> bool:
    """Whether Ctrl-C has come since ``let_ctrl_c_interrupt``: an error after it may be its consequence."""
    return _interrupted.is_set()


def stop_if_interrupted() -> None:
    """Raises KeyboardInterrupt when Ctrl-C has come since ``let_ctrl_c_interrupt`` and nothing has come of it."""
    if interrupted():
        raise KeyboardInterrupt


def _interrupt(signum: int, frame: FrameType | None) -> None:
    if signum == signal.SIGINT:
        _interrupted.set()
    if _importing(frame):
        _hold_back(signal.Signals(signum))
        return
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    raise KeyboardInterrupt if signum == signal.SIGINT else SystemExit(EXIT_TERMINATED)


def _hold_back(number: signal.Signals) -> None:
    _held_back[0] = number
    signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)  # no thread: its locks may be held where the signal came


def _importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            return True
        frame = frame.f_back
    return False


def _send_again(signum: int, frame: FrameType | None) -> None:
    os.kill(os.getpid(), _held_back[0])  # not raised here, so that it can be held back as the first one can


def _unraisable(error: sys.UnraisableHookArgs) -> None:
    if error.exc_type is KeyboardInterrupt:
        _hold_back(signal.SIGINT)
    elif isinstance(error.exc_value, SystemExit) and error.exc_value.code == EXIT_TERMINATED:
        _hold_back(signal.SIGTERM)
    else:
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
