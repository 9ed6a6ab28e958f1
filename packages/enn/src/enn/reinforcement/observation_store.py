"""Observation stores: many observations of one kind, as small as they can be kept without loss.

Vectors are kept as numbers, masks as bits, images as their compressed difference to one of them: in images of a fixed
camera little but the wire changes, so that a difference is nearly all zeros. Whatever is written is read bit by bit,
noise too, which only takes more memory.
"""

from __future__ import annotations

import sys
import zlib
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

MASK = "mask"  # what a name of a two-valued image starts with
# Expected size of a compressed frame, as a share of its pixels; simulated images take less (docs/results/computing.md).
EXPECTED_SHARE = 1 / 20
_LEVEL = 1  # of zlib: the fastest; level 6 saves a quarter more and takes three times as long
_REFERENCE = 8  # bytes that name a stack in the list of rows

Frames = tuple[bytes, ...]  # of one observation, channel by channel


class ObservationStore:
    """Rows of one observation in an array: masks as bits, vectors as float32 or half precision; see `make_store`.

    Args:
        name: of the observation; one that starts with "mask" and is a uint8 image is kept as bits.
        shape: of the rows, such as (slots, environments).
        half: keeps floating-point values in half precision.

    Raises:
        ValueError: the space is no `Box`.
    """

    def __init__(self, name: str, space: gymnasium.Space[Any], shape: tuple[int, ...], half: bool = False) -> None:
        self.name, self.space_shape, self.packed = name, tuple(space.shape or ()), is_packed(name, space)
        self.size = int(np.prod(self.space_shape))
        self._depth = len(shape)
        self.dtype = _dtype(space)
        if self.packed:
            self.array: NDArray[Any] = np.zeros((*shape, -(-self.size // 8)), np.uint8)
        else:
            self.array = np.zeros((*shape, *self.space_shape), _stored_dtype(self.dtype, half))

    def write(self, row: int, values: NDArray[Any]) -> None:
        """Writes one row.

        Args:
            values: what belongs there. Shape (environments, ...), or of one observation.

        Raises:
            ValueError: a mask with other values than 0 and 255.
        """
        if not self.packed:
            self.array[row] = values
            return
        # 0 and 255 become 1 and 0: every other value keeps a higher bit
        if ((values + np.uint8(1)) & np.uint8(0xFE)).any():
            raise ValueError(f"the observation '{self.name}' must hold 0 and 255 alone to be kept as bits")
        self.array[row] = np.packbits(values.reshape(*values.shape[: values.ndim - len(self.space_shape)], -1), axis=-1)

    def read(self, rows: NDArray[np.integer[Any]]) -> NDArray[Any]:
        """Reads rows, counted through all leading dimensions. Shape (rows, ...)."""
        flat = self.array.reshape(-1, *self.array.shape[self._depth :])[rows]
        if not self.packed:
            return flat if flat.dtype == self.dtype else flat.astype(self.dtype)
        bits = np.unpackbits(flat, axis=-1, count=self.size)
        return (bits * np.uint8(255)).reshape(len(rows), *self.space_shape)

    @property
    def rows(self) -> int:
        """Number of rows, of all environments together in each."""
        return len(self.array)

    @property
    def nbytes(self) -> int:
        """Bytes allocated."""
        return self.array.nbytes

    def saved(self, first: int, last: int) -> NDArray[Any]:
        """Rows from first up to last, for `put_back`."""
        return self.array[first:last]

    def put_back(self, first: int, last: int, packed: NDArray[Any]) -> None:
        """Puts rows back.

        Raises:
            ValueError: it is of another number of rows or of another observation.
        """
        if packed.shape != self.array[first:last].shape or packed.dtype != self.array.dtype:
            raise ValueError(f"the saved rows of '{self.name}' are of another size than this buffer's")
        self.array[first:last] = packed

    def grow(self, rows: int) -> None:
        """Reserves memory for more rows and keeps the present ones."""
        larger = np.zeros((rows, *self.array.shape[1:]), self.array.dtype)
        larger[: len(self.array)] = self.array
        self.array = larger


class FrameStore:
    """Rows of one image observation, as `ObservationStore` keeps others.

    A stack of images that goes on from the one written before it, for the same environment, shares their frames.

    Args:
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
        frames = np.zeros((len(rows), channels, height, width), np.uint8)
        reference = self.reference
        if reference is None:
            return frames
        places: dict[bytes, tuple[int, int]] = {}
        for place, row in enumerate(rows.tolist()):
            stack = self._rows[row]
            if stack is None:
                continue
            for channel, frame in enumerate(stack):
                first = places.setdefault(frame, (place, channel))
                if first == (place, channel):
                    pixels = np.frombuffer(zlib.decompress(frame), np.uint8).reshape(height, width)
                    np.add(pixels, reference, out=frames[place, channel])
                else:
                    frames[place, channel] = frames[first]
        return frames

    def grow(self, rows: int) -> None:
        """Reserves memory for more rows and keeps the present ones."""
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
            last: the row after them.
            packed: from `saved` for so many rows.

        Raises:
            ValueError: it is of another number of rows or of other images.
        """
        channels, data = self.space_shape[0], packed.tobytes()
        count = int(np.frombuffer(data, np.int64, 1)[0]) if len(data) >= 8 else -1
        size, head = (last - first) * self.envs * channels, 8 * (1 + count)
        lengths = np.frombuffer(data[8:head], np.int64) if 0 <= count <= size else np.zeros(0, np.int64)
        if count < 0 or len(lengths) != count or len(data) != head + 8 * size + int(lengths.sum()):
            raise ValueError(f"the saved frames of '{self.name}' are of another size than this buffer's")
        numbers = np.frombuffer(data[head : head + 8 * size], np.int64).tolist()
        ends = (head + 8 * size + np.cumsum(lengths)).tolist()
        frames = [data[end - length : end] for end, length in zip(ends, lengths.tolist(), strict=True)]
        for row in range((last - first) * self.envs):
            own = numbers[row * channels : (row + 1) * channels]
            self._rows[first * self.envs + row] = None if own[0] < 0 else tuple(frames[number] for number in own)


def make_store(
    name: str, space: gymnasium.Space[Any], shape: tuple[int, ...], half: bool = False
) -> ObservationStore | FrameStore:
    """The store of an observation: a `FrameStore` for images that are no masks.

    Args:
        shape: of the rows, (slots, environments) or (slots,).
        half: keeps floating-point values in half precision.
    """
    return FrameStore(name, space, shape) if is_image(name, space) else ObservationStore(name, space, shape, half)


def is_packed(name: str, space: gymnasium.Space[Any]) -> bool:
    """Whether an observation is kept as bits."""
    return name.startswith(MASK) and _is_picture(space)


def is_image(name: str, space: gymnasium.Space[Any]) -> bool:
    """Whether an observation is kept as compressed frames."""
    return not name.startswith(MASK) and _is_picture(space)


def bytes_per_observation(name: str, space: gymnasium.Space[Any], half: bool = False) -> int:
    """Bytes that one observation takes; of an image, what is expected."""
    size = int(np.prod(space.shape or ()))
    if is_image(name, space):
        return int(size * EXPECTED_SHARE)
    return -(-size // 8) if is_packed(name, space) else size * _stored_dtype(_dtype(space), half).itemsize


def _is_picture(space: gymnasium.Space[Any]) -> bool:
    return space.dtype == np.uint8 and len(space.shape or ()) == 3


def _dtype(space: gymnasium.Space[Any]) -> np.dtype[Any]:
    if not isinstance(space, gymnasium.spaces.Box):
        raise ValueError(f"observations are kept in Box or Dict of Box spaces, got {space}")
    # networks compute in single precision
    return np.dtype(np.float32) if np.issubdtype(space.dtype, np.floating) else np.dtype(space.dtype)


def _stored_dtype(dtype: np.dtype[Any], half: bool) -> np.dtype[Any]:
    return np.dtype(np.float16) if half and dtype == np.float32 else dtype
