"""Memory that a job has freed goes back to the system, which the GNU C library by itself does late or never.

With another C library nothing happens.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc

_MMAP_THRESHOLD = -3  # M_MMAP_THRESHOLD of malloc.h
_OF_A_SIMULATION = 12 * 2**20  # bytes; MuJoCo's arenas are larger


def return_freed_memory() -> None:
    """Frees what only refers to itself, and returns freed memory to the system: up to half of what a training takes."""
    gc.collect()
    with contextlib.suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def map_simulations() -> None:
    """Lets MuJoCo's arenas lie in pages of their own from now on, which go back at once.

    For jobs that make simulations by the thousand: every anatomy has some twenty, each with an arena of 16 MB of which
    it uses a hundredth, and on the heap the used parts pile up. Networks on images would allocate more slowly.
    """
    with contextlib.suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).mallopt(_MMAP_THRESHOLD, _OF_A_SIMULATION)
