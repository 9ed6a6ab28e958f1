"""Frame store: images as their compressed difference to one of them, each frame of a stack of the latest kept once.

In images of a fixed camera little but the wire changes, so that a difference is nearly all zeros. Nothing is lost:
whatever is written is read bit by bit, noise too, which only takes more memory.
"""

from __future__ import annotations

import sys
import zlib
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

_LEVEL = 1  # of zlib: the fastest; level 6 saves a quarter more and takes three times as long
_REFERENCE = 8  # bytes that name a stack in the list of rows
# What a frame takes, as a share of its pixels, where a size is to be told before any is there; simulated images take
# less (docs/results/memory.md).
EXPECTED_SHARE = 1 / 20

Frames = tuple[bytes, ...]  # of one observation, channel by channel


class FrameStore:
    """Rows of one image observation, as `ObservationStore` keeps others.

    A stack of images that goes on from the one written before it, for the same environment, shares their frames.

    Args:
        name: of the observation.
        space: of one observation, (channels, height, width) uint8.
        shape: of the rows: (slots, environments) or (slots,).
    """

    def __init__(self, name: str, space: gymnasium.Space[Any], shape: tuple[int, ...]) -> None:
        self.name = name
        self.space_shape: tuple[int, ...] = tuple(space.shape or ())
        self.envs = shape[1] if len(shape) > 1 else 1
        self.reference: NDArray[np.uint8] | None = None  # (height, width), the first frame of all
        self._rows: list[Frames | None] = [None] * int(np.prod(shape))
        self._latest: list[tuple[NDArray[np.uint8], Frames] | None] = [None] * self.envs

    @property
    def rows(self) -> int:
        """Number of rows, of all environments together in each."""
        return len(self._rows) // self.envs

    @property
    def nbytes(self) -> int:
        """Bytes that the frames take now, each counted once."""
        filled = [stack for stack in self._rows if stack is not None]
        stacks = {id(stack): stack for stack in filled}
        frames = {id(frame): frame for stack in stacks.values() for frame in stack}
        objects = (*stacks.values(), *frames.values())
        return sum(map(sys.getsizeof, objects)) + _REFERENCE * len(filled)

    def write(self, row: int, values: NDArray[np.uint8]) -> None:
        """Writes one row.

        Args:
            row: which.
            values: what belongs there. Shape (environments, channels, height, width), or of one observation.
        """
        values = values.reshape(self.envs, *self.space_shape)
        if self.reference is None:
            self.reference = values[0, 0].copy()
        for env, stack in enumerate(values):
            self._rows[row * self.envs + env] = self._compressed(env, stack)

    def _compressed(self, env: int, stack: NDArray[np.uint8]) -> Frames:
        latest = self._latest[env]
        if latest is not None and np.array_equal(stack, latest[0]):
            return latest[1]
        known: list[bytes] = []
        if latest is not None and len(stack) > 1 and np.array_equal(stack[:-1], latest[0][1:]):
            known = list(latest[1][1:])
        frames = (*known, *(zlib.compress((frame - self.reference).tobytes(), _LEVEL) for frame in stack[len(known) :]))
        self._latest[env] = stack.copy(), frames
        return frames

    def read(self, rows: NDArray[np.integer[Any]]) -> NDArray[np.uint8]:
        """Reads rows, counted through environments. Shape (rows, channels, height, width)."""
        channels, height, width = self.space_shape
        found = np.zeros((len(rows), channels, height, width), np.uint8)
        reference = self.reference
        if reference is None:
            return found
        places: dict[bytes, tuple[int, int]] = {}
        for place, row in enumerate(rows.tolist()):
            stack = self._rows[row]
            if stack is None:
                continue
            for channel, frame in enumerate(stack):
                first = places.setdefault(frame, (place, channel))
                if first == (place, channel):
                    pixels = np.frombuffer(zlib.decompress(frame), np.uint8).reshape(height, width)
                    np.add(pixels, reference, out=found[place, channel])
                else:
                    found[place, channel] = found[first]
        return found

    def grow(self, rows: int) -> None:
        """Makes room for more rows, keeping those there are."""
        self._rows += [None] * (rows * self.envs - len(self._rows))

    def saved(self, first: int, last: int) -> NDArray[np.uint8]:
        """Rows from first up to last as one array of bytes, each frame once; `put_back` takes it."""
        frames: dict[bytes, int] = {}
        numbers = [
            -1 if stack is None else frames.setdefault(stack[channel], len(frames))
            for stack in self._rows[first * self.envs : last * self.envs]
            for channel in range(self.space_shape[0])
        ]
        head = np.array([len(frames), *map(len, frames)], np.int64), np.array(numbers, np.int64)
        return np.frombuffer(b"".join((head[0].tobytes(), head[1].tobytes(), *frames)), np.uint8)

    def put_back(self, first: int, last: int, packed: NDArray[np.uint8]) -> None:
        """Puts rows back.

        Args:
            first: of the rows.
            last: the row after them.
            packed: from `saved` for so many rows.

        Raises:
            ValueError: it is of another number of rows or of other images.
        """
        channels, data = self.space_shape[0], packed.tobytes()
        count = int(np.frombuffer(data, np.int64, 1)[0]) if len(data) >= 8 else -1
        wanted, head = (last - first) * self.envs * channels, 8 * (1 + count)
        lengths = np.frombuffer(data[8:head], np.int64) if 0 <= count <= wanted else np.zeros(0, np.int64)
        if count < 0 or len(lengths) != count or len(data) != head + 8 * wanted + int(lengths.sum()):
            raise ValueError(f"the saved frames of '{self.name}' are of another size than this buffer's")
        numbers = np.frombuffer(data[head : head + 8 * wanted], np.int64).tolist()
        ends = (head + 8 * wanted + np.cumsum(lengths)).tolist()
        frames = [data[end - length : end] for end, length in zip(ends, lengths.tolist(), strict=True)]
        for row in range((last - first) * self.envs):
            own = numbers[row * channels : (row + 1) * channels]
            self._rows[first * self.envs + row] = None if own[0] < 0 else tuple(frames[number] for number in own)
