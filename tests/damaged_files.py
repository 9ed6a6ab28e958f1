"""Damaged files: what every file with a digest is tried with."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

SAMPLE = 60  # bits drawn over the whole file
HEADER = 1100  # bytes at the start in which every 45th bit, and all bits of the first line, are turned over


def damaged(whole: bytes, seed: int = 0) -> Iterator[bytes]:
    """A file's bytes with one bit turned over at a time, cut off, and with a byte more."""
    line = whole.index(b"\n") + 1
    drawn = np.random.default_rng(seed).integers(0, 8 * len(whole), SAMPLE).tolist()
    data = bytearray(whole)
    for bit in (*range(8 * line), *range(8 * line, 8 * min(HEADER, len(whole)), 45), *drawn):
        data[bit // 8] ^= 1 << bit % 8
        yield bytes(data)
        data[bit // 8] ^= 1 << bit % 8
    for length in (0, 1, line - 1, line, len(whole) // 2, len(whole) - 1):
        yield whole[:length]
    yield whole + b"\0"


def refusals(path: Path, load: Callable[[], object], seed: int = 0) -> list[str]:
    """Loads every damaged variant of a file; each has to be refused with one sentence.

    Args:
        path: of the intact file, which is there again at the end.
        load: reads it.
        seed: of the bits that are drawn.

    Returns:
        The messages.
    """
    whole = path.read_bytes()
    messages = []
    for data in damaged(whole, seed):
        path.write_bytes(data)
        try:
            load()
        except ValueError as error:
            messages.append(str(error))
        else:
            raise AssertionError(f"a damaged {path.name} was loaded")
    path.write_bytes(whole)
    load()
    assert not any("\n" in message for message in messages)
    return messages
