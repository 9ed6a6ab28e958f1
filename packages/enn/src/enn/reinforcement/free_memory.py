"""Memory that a process may still take."""

from __future__ import annotations

import os
from pathlib import Path

_LIMIT = Path("/sys/fs/cgroup/memory.max")
_USED = Path("/sys/fs/cgroup/memory.current")
_INFO = Path("/proc/meminfo")


def available_bytes() -> int:
    """Bytes available without swapping: the machine's, or what a container's limit leaves, whichever is less."""
    there = _machine()
    try:
        limit = _LIMIT.read_text().strip()
        if limit != "max":
            there = min(there, max(int(limit) - int(_USED.read_text()), 0))
    except (OSError, ValueError):
        pass  # no control groups here
    return there


def _machine() -> int:
    try:
        for line in _INFO.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except (OSError, ValueError):
        pass  # not Linux: what is installed is all that can be known
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
