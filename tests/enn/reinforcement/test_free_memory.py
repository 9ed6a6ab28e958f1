"""Memory that is free in the heap is given back."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
from pathlib import Path

import pytest

from enn.reinforcement.free_memory import available_bytes, trim_heap

# small blocks, so that all lie in the heap; one in a hundred stays, so that its end cannot sink
_PROGRAM = """
from pathlib import Path
from enn.reinforcement.free_memory import trim_heap

def resident_mb():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6

blocks = [bytearray(100_000) for _ in range(2000)]
blocks = blocks[::100]
before = resident_mb()
trim_heap()
print(before - resident_mb())
"""


def test_there_is_memory() -> None:
    assert available_bytes() > 0
    trim_heap()


@pytest.mark.skipif(
    os.name != "posix" or not hasattr(ctypes.CDLL(None), "malloc_trim") or not Path("/proc/self/statm").is_file(),
    reason="another C library than glibc",
)
def test_holes_in_the_heap_are_given_back() -> None:
    run = subprocess.run([sys.executable, "-c", _PROGRAM], capture_output=True, text=True, check=True)
    assert float(run.stdout) > 100
