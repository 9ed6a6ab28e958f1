"""Progress of a stage: a bar on a terminal, a plain line now and then in a log."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Iterator, Sequence
from typing import TypeVar

from tqdm import tqdm

Item = TypeVar("Item")

_LOGGER = logging.getLogger(__name__)
_SECONDS_BETWEEN_LINES = 5.0


def progress(items: Sequence[Item], label: str, *, done_before: int = 0) -> Iterator[Item]:
    """Passes items on and says how far the work is and how long the rest will take.

    Args:
        done_before: items that an earlier, interrupted run already finished; they count in the total, not in the
            estimate.
    """
    total = done_before + len(items)
    if sys.stderr.isatty():
        yield from tqdm(items, desc=label, initial=done_before, total=total, dynamic_ncols=True, leave=False)
        return
    start = last_line = time.monotonic()
    for count, item in enumerate(items):
        yield item
        now = time.monotonic()
        is_last = count + 1 == len(items)
        if is_last or now - last_line >= _SECONDS_BETWEEN_LINES:
            last_line = now
            _LOGGER.info("%s", progress_line(label, done_before + count + 1, total, now - start, count + 1))


def progress_line(label: str, done: int, total: int, elapsed_s: float, done_now: int) -> str:
    """Words one line of progress.

    Args:
        done_now: items this run has finished, at least one.

    Returns:
        For example ``phantoms 2/6, 8 s, about 16 s left``.
    """
    left_s = elapsed_s / done_now * (total - done)
    rest = f", about {left_s:.0f} s left" if done < total else ""
    return f"{label} {done}/{total}, {elapsed_s:.0f} s{rest}"
