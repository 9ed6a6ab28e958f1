"""Values at the nodes of a regular lattice, in blocks of 8 x 8 x 8 nodes; blocks that hold one constant are shared.

Every block also keeps a copy of the nodes next to it, so that any 3 x 3 x 3 nodes lie within one block: the one that
their middle belongs to. The native code reads the same layout (native/lattice.h).
"""

from __future__ import annotations

import contextlib
import ctypes
import mmap
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

EDGE = 8  # nodes of its own along the edge of a block
SIDE = EDGE + 2  # nodes along the edge of a stored block, those of its neighbours included
STRIDES = np.array([SIDE * SIDE, SIDE, 1])

_OWN = slice(1, EDGE + 1)
_BATCH = 2**20  # nodes handled at once, so that memory stays bounded
_LARGEST = 2**31  # nodes along an axis

Shape = tuple[int, int, int]
Box = tuple[slice, slice, slice]


@dataclass(frozen=True, eq=False)
class NodeBlocks:
    """Values (nx, ny, nz) of a lattice, float32 or int32, never changed."""

    shape: Shape  # number of nodes along x, y, z
    table: NDArray[np.int32]  # (bx, by, bz) number of each block, in C order; 0 where all nodes hold the constant
    nodes: NDArray  # (blocks, 10, 10, 10); block 0 holds the constant everywhere

    def __post_init__(self) -> None:
        expected = tuple(-(-n // EDGE) for n in self.shape)
        if self.table.shape != expected:
            raise ValueError(
                f"a lattice of {self.shape} nodes has {expected} blocks, got a table of {self.table.shape}."
            )
        if self.nodes.ndim != 4 or self.nodes.shape[1:] != (SIDE, SIDE, SIDE) or not len(self.nodes):
            raise ValueError(f"blocks must have shape (n, {SIDE}, {SIDE}, {SIDE}), got {self.nodes.shape}.")
        for array in (self.table, self.nodes):
            array.flags.writeable = False

    @classmethod
    def from_dense(cls, values: NDArray) -> NodeBlocks:
        """Blocks of a dense array (nx, ny, nz); those that hold the least value everywhere are shared."""
        if values.ndim != 3 or not values.size:
            raise ValueError(f"a lattice needs values of shape (nx, ny, nz), got {values.shape}.")
        least = values.min()
        nx, ny, nz = values.shape
        return cls.from_slabs([values], (nx, ny, nz), 0.0 if np.isnan(least) else float(least))

    @classmethod
    def from_slabs(cls, slabs: Iterable[NDArray], shape: Shape, constant: float) -> NodeBlocks:
        """Blocks of a lattice that comes slab by slab, so that it is never dense as a whole.

        Args:
            slabs: (layers, ny, nz), one after the other along x; all but the last of a multiple of 8 layers.
        """
        occupied, cores = [], []
        for slab in slabs:
            blocks = tuple(-(-n // EDGE) for n in slab.shape)
            padding = [(0, EDGE * b - n) for b, n in zip(blocks, slab.shape, strict=True)]
            padded = np.pad(slab, padding, constant_values=constant) if any(after for _, after in padding) else slab
            split = padded.reshape(blocks[0], EDGE, blocks[1], EDGE, blocks[2], EDGE).transpose(0, 2, 4, 1, 3, 5)
            occupied.append((split != slab.dtype.type(constant)).any(axis=(3, 4, 5)))
            cores.append(split[occupied[-1]])
        return cls.from_cores(np.concatenate(occupied), np.concatenate(cores), shape, constant)

    @classmethod
    def from_nodes(cls, indices: ArrayLike, values: NDArray, shape: Shape, constant: float) -> NodeBlocks:
        """Blocks of a lattice of which only some nodes are given; all others hold a constant.

        Args:
            indices: (n, 3) whole numbers, within `shape`.
            values: (n,) at those nodes; of a node given twice the last counts.

        Raises:
            ValueError: other shapes, or an index outside the lattice.
        """
        indices, values = np.asarray(indices), np.asarray(values)
        if indices.ndim != 2 or indices.shape[1] != 3 or indices.dtype.kind not in "iu":
            raise ValueError(f"indices must be whole numbers of shape (n, 3), got {indices.dtype} {indices.shape}.")
        if values.shape != (len(indices),):
            raise ValueError(f"values must have shape ({len(indices)},) like the indices, got {values.shape}.")
        if len(shape) != 3 or not all(0 < n < _LARGEST for n in shape):
            raise ValueError(f"a lattice has (nx, ny, nz) nodes, at least one each, got {tuple(shape)}.")
        if len(indices) and (indices.min() < 0 or (indices.max(axis=0) >= shape).any()):
            low, high = indices.min(axis=0).tolist(), indices.max(axis=0).tolist()
            raise ValueError(f"indices must lie within a lattice of {tuple(shape)} nodes, got {low} to {high}.")
        blocks = tuple(-(-n // EDGE) for n in shape)
        batches = [slice(first, first + _BATCH) for first in range(0, len(indices), _BATCH)]
        occupied = np.zeros(blocks, dtype=bool)
        for batch in batches:
            occupied[tuple((indices[batch] >> 3).T)] = True
        number = np.cumsum(occupied, dtype=np.int64).reshape(blocks) - 1
        cores = np.full((int(occupied.sum()), EDGE**3), constant, dtype=values.dtype)
        for batch in batches:
            at = indices[batch]
            x, y, z = (at & (EDGE - 1)).T
            cores[number[tuple((at >> 3).T)], x * EDGE**2 + y * EDGE + z] = values[batch]
        nx, ny, nz = (int(n) for n in shape)
        return cls.from_cores(occupied, cores.reshape(-1, EDGE, EDGE, EDGE), (nx, ny, nz), constant)

    @classmethod
    def from_cores(cls, occupied: NDArray[np.bool_], cores: NDArray, shape: Shape, constant: float) -> NodeBlocks:
        """Blocks from the own nodes (k, 8, 8, 8) of those that are occupied (bx, by, bz), in C order.

        Nodes beyond the lattice must hold the constant.
        """
        from cathsim.contact.native import address, library

        cores = np.ascontiguousarray(cores)
        numbers = np.where(occupied, np.cumsum(occupied).reshape(occupied.shape) - 1, -1).astype(np.int32)
        counts = np.array(occupied.shape, dtype=np.int32)
        fill = np.array([constant], dtype=cores.dtype).view(np.uint32)
        block_addresses = (address(counts), address(numbers))
        stored = np.zeros(occupied.shape, dtype=np.uint8)
        library().cathsim_mark_blocks(*block_addresses, address(cores), ctypes.c_uint32(int(fill[0])), address(stored))
        table = np.where(stored, np.cumsum(stored, dtype=np.int32).reshape(stored.shape), 0).astype(np.int32)
        nodes = _mapped((int(stored.sum()) + 1, SIDE, SIDE, SIDE), cores.dtype)
        library().cathsim_fill_blocks(
            *block_addresses, address(table), address(cores), ctypes.c_uint32(int(fill[0])), address(nodes)
        )
        return cls(shape, table, nodes)

    @property
    def constant(self) -> float:
        """The value of all nodes in blocks that are not stored."""
        return self.nodes[0, 0, 0, 0].item()

    @property
    def nbytes(self) -> int:
        """Memory, bytes."""
        return self.table.nbytes + self.nodes.nbytes

    @cached_property
    def places(self) -> NDArray[np.int64]:
        """Index (blocks - 1, 3) of the first node of each stored block."""
        return np.argwhere(self.table) * EDGE

    @property
    def own(self) -> NDArray:
        """Own nodes (blocks - 1, 8, 8, 8) of the stored blocks; those beyond the lattice hold the constant."""
        return self.nodes[1:, _OWN, _OWN, _OWN]

    @property
    def stored(self) -> NDArray[np.bool_]:
        """Which blocks (bx, by, bz) are stored."""
        return self.table > 0

    def dense(self, box: Box | None = None) -> NDArray:
        """The values in a box of the lattice as a dense array, by default all of them."""
        spans = [range(n)[s] for n, s in zip(self.shape, box or (slice(None),) * 3, strict=True)]
        if any(span.step != 1 for span in spans):
            raise ValueError(f"a box is three slices without a step, got {box}.")
        table = self.table[tuple(slice(span.start // EDGE, -(-span.stop // EDGE)) for span in spans)]
        whole = np.full(EDGE * np.array(table.shape), self.constant, dtype=self.nodes.dtype)
        split = whole.reshape([n for count in table.shape for n in (count, EDGE)]).transpose(0, 2, 4, 1, 3, 5)
        stored = table > 0
        split[stored] = self.own[table[stored] - 1]
        within = tuple(slice(span.start % EDGE, span.start % EDGE + len(span)) for span in spans)
        return np.ascontiguousarray(whole[within])

    def where(self, condition: Callable[[NDArray], NDArray[np.bool_]]) -> tuple[NDArray[np.int32], NDArray]:
        """Nodes whose values fulfil a condition.

        Returns:
            Indices (n, 3) int32, in C order, and values (n,).
        """
        if condition(self.nodes[0, :1, 0, 0])[0]:  # the constant does: there is nothing to leave out
            dense = self.dense()
            mask = condition(dense)
            return np.argwhere(mask).astype(np.int32), dense[mask]
        indices, values = [np.zeros((0, 3), dtype=np.int32)], [np.zeros(0, dtype=self.nodes.dtype)]
        for layer in np.flatnonzero(self.table.any(axis=(1, 2))):
            stored = np.argwhere(self.table[layer])
            low, high = EDGE * stored.min(axis=0), EDGE * (stored.max(axis=0) + 1)
            first = EDGE * int(layer)
            box = (slice(first, first + EDGE), slice(int(low[0]), int(high[0])), slice(int(low[1]), int(high[1])))
            dense = self.dense(box)
            mask = condition(dense)
            indices.append(np.argwhere(mask).astype(np.int32) + np.array([first, *low], dtype=np.int32))
            values.append(dense[mask])
        return np.concatenate(indices), np.concatenate(values)

    def box_where(self, condition: Callable[[NDArray], NDArray[np.bool_]]) -> NDArray[np.int32]:
        """Lowest and highest index (2, 3) of the nodes whose values fulfil a condition.

        Raises:
            ValueError: none does.
        """
        if condition(self.nodes[0, :1, 0, 0])[0]:  # the constant does: own nodes beyond the lattice hold it, too
            indices = self.where(condition)[0]
            return np.stack([indices.min(axis=0), indices.max(axis=0)])
        mask, box = condition(self.own), np.empty((2, 3), dtype=np.int32)
        for axis in range(3):
            others = tuple(k + 1 for k in range(3) if k != axis)
            along = (self.places[:, axis, None] + np.arange(EDGE))[mask.any(axis=others)]
            box[:, axis] = along.min(), along.max()
        return box

    def own_indices(self, mask: NDArray[np.bool_]) -> NDArray[np.int32]:
        """Indices (n, 3) of nodes chosen among `own` (blocks - 1, 8, 8, 8), block by block."""
        places, pieces = self.places.astype(np.int32), [np.zeros((0, 3), dtype=np.int32)]
        for first in range(0, len(places), _BATCH // EDGE**3):
            indices = np.argwhere(mask[first : first + _BATCH // EDGE**3])
            pieces.append(places[first + indices[:, 0]] + indices[:, 1:].astype(np.int32))
        return np.concatenate(pieces)

    def mapped(self, change: Callable[[NDArray], NDArray]) -> NodeBlocks:
        """The same lattice with every value changed alike by a function of arrays."""
        return NodeBlocks(self.shape, self.table, np.ascontiguousarray(change(self.nodes)))

    def coarser(self, stride: int) -> NodeBlocks:
        """Every `stride`-th node along each axis, from the first on."""
        if stride == 1:
            return self
        shape = tuple(-(-n // stride) for n in self.shape)
        mask = self._on_stride(stride)
        nx, ny, nz = shape
        return self.from_nodes(self.own_indices(mask) // stride, self.own[mask], (nx, ny, nz), self.constant)

    def _on_stride(self, stride: int) -> NDArray[np.bool_]:
        axes = [
            ((self.places[:, k, None] + np.arange(EDGE)) % stride == 0)
            & (self.places[:, k, None] + np.arange(EDGE) < self.shape[k])
            for k in range(3)
        ]
        return axes[0][:, :, None, None] & axes[1][:, None, :, None] & axes[2][:, None, None, :]

    def maximum_along(self, axis: int) -> NDArray:
        """The largest value along an axis, of the two others; the constant must be the least value."""
        return self._along(axis, self.own.max(axis=axis + 1), np.maximum, self.constant)

    def sum_along(self, axis: int, change: Callable[[NDArray], NDArray]) -> NDArray[np.float64]:
        """The sum along an axis of values changed by a function that is zero at the constant."""
        return self._along(axis, change(self.own).sum(axis=axis + 1, dtype=np.float64), np.add, 0.0)

    def _along(self, axis: int, faces: NDArray, join: np.ufunc, start: float) -> NDArray:
        others = [k for k in range(3) if k != axis]
        blocks = [self.table.shape[k] for k in others]
        flat = np.full((blocks[0], blocks[1], EDGE, EDGE), start, dtype=faces.dtype)
        join.at(flat, tuple(self.places[:, others].T // EDGE), faces)
        joined = flat.transpose(0, 2, 1, 3).reshape(blocks[0] * EDGE, blocks[1] * EDGE)
        return np.ascontiguousarray(joined[: self.shape[others[0]], : self.shape[others[1]]])

    def at(self, indices: NDArray[np.integer]) -> NDArray:
        """Values (n,) at nodes (n, 3)."""
        flat, values = self.nodes.reshape(-1), np.empty(len(indices), dtype=self.nodes.dtype)
        for first in range(0, len(indices), _BATCH):
            batch = slice(first, first + _BATCH)
            values[batch] = flat[self.positions(indices[batch])]
        return values

    def interpolated(self, index: NDArray[np.float64]) -> NDArray[np.float64]:
        """Trilinear interpolation at fractional indices (..., 3), clamped to the lattice."""
        from cathsim.contact.native import address, library

        index = np.ascontiguousarray(index, dtype=np.float64)
        result = np.empty(index.shape[:-1])
        count = ctypes.c_int64(result.size)
        library().cathsim_interpolate(ctypes.byref(self._struct), count, address(index), address(result))
        return result

    @cached_property
    def _struct(self) -> ctypes.Structure:
        if self.nodes.dtype != np.float32:
            raise TypeError(f"only values of float32 can be interpolated, got {self.nodes.dtype}.")
        return LatticeStruct.of(self)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_struct"}  # it points into memory

    def positions(self, indices: NDArray[np.integer]) -> NDArray[np.int64]:
        """Where nodes (..., 3) stand in `nodes` as a flat array; their neighbours are `STRIDES` away.

        The indices must lie within the lattice.
        """
        at = indices >> 3
        block = self.table[at[..., 0], at[..., 1], at[..., 2]].astype(np.int64)
        within = [(indices[..., k] & (EDGE - 1)) + 1 for k in range(3)]
        return block * SIDE**3 + (within[0] * SIDE**2 + within[1] * SIDE + within[2])


def _mapped(shape: tuple[int, ...], dtype: np.dtype) -> NDArray:
    """An array in pages of its own, which go back to the system with it.

    The C library would keep them: a training that reads one arch after the other would take twice the memory.
    """
    size = int(np.prod(shape)) * dtype.itemsize
    own = {"flags": mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS} if hasattr(mmap, "MAP_ANONYMOUS") else {}
    pages = mmap.mmap(-1, size, **own)
    if hasattr(mmap, "MADV_HUGEPAGE"):
        with contextlib.suppress(OSError):  # a kernel without them
            pages.madvise(mmap.MADV_HUGEPAGE)
    return np.frombuffer(pages, dtype=dtype).reshape(shape)


class LatticeStruct(ctypes.Structure):
    """Values at the nodes of a lattice (struct Lattice of lattice.h)."""

    _fields_ = (
        ("size", ctypes.c_int * 3),
        ("blocks", ctypes.c_int * 3),
        ("table", ctypes.c_void_p),
        ("nodes", ctypes.c_void_p),
    )

    @classmethod
    def of(cls, blocks: NodeBlocks) -> LatticeStruct:
        """The struct of float32 values, which must outlive its use."""
        return cls(blocks.shape, blocks.table.shape, blocks.table.ctypes.data, blocks.nodes.ctypes.data)
