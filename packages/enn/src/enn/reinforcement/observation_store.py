"""Observation store: many observations of one kind, as small as they can be kept without loss."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from enn.reinforcement.frame_store import EXPECTED_SHARE, FrameStore

MASK = "mask"  # what a name of a two-valued image starts with


class ObservationStore:
    """Rows of one observation in an array: masks as bits, vectors as float32 or half precision; see `make_store`.

    Args:
        name: of the observation; one that starts with "mask" and is a uint8 image is kept as bits.
        space: of one observation.
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
            row: which.
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
        """Makes room for more rows, keeping those there are."""
        larger = np.zeros((rows, *self.array.shape[1:]), self.array.dtype)
        larger[: len(self.array)] = self.array
        self.array = larger


def is_packed(name: str, space: gymnasium.Space[Any]) -> bool:
    """Whether an observation is kept as bits."""
    return name.startswith(MASK) and space.dtype == np.uint8 and len(space.shape or ()) == 3


def make_store(
    name: str, space: gymnasium.Space[Any], shape: tuple[int, ...], half: bool = False
) -> ObservationStore | FrameStore:
    """The store of an observation: a `FrameStore` for images that are no masks.

    Args:
        name: of the observation.
        space: of one observation.
        shape: of the rows, (slots, environments) or (slots,).
        half: keeps floating-point values in half precision.
    """
    return FrameStore(name, space, shape) if is_image(name, space) else ObservationStore(name, space, shape, half)


def is_image(name: str, space: gymnasium.Space[Any]) -> bool:
    """Whether an observation is kept as compressed frames."""
    return not name.startswith(MASK) and space.dtype == np.uint8 and len(space.shape or ()) == 3


def bytes_per_observation(name: str, space: gymnasium.Space[Any], half: bool = False) -> int:
    """Bytes that one observation takes; of an image, what is expected."""
    size = int(np.prod(space.shape or ()))
    if is_image(name, space):
        return int(size * EXPECTED_SHARE)
    return -(-size // 8) if is_packed(name, space) else size * _stored_dtype(_dtype(space), half).itemsize


def _dtype(space: gymnasium.Space[Any]) -> np.dtype[Any]:
    if not isinstance(space, gymnasium.spaces.Box):
        raise ValueError(f"observations are kept in Box or Dict of Box spaces, got {space}")
    # networks compute in single precision
    return np.dtype(np.float32) if np.issubdtype(space.dtype, np.floating) else np.dtype(space.dtype)


def _stored_dtype(dtype: np.dtype[Any], half: bool) -> np.dtype[Any]:
    return np.dtype(np.float16) if half and dtype == np.float32 else dtype
