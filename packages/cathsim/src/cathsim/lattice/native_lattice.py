"""A lattice as the native code reads it."""

from __future__ import annotations

import ctypes

from cathsim.lattice.node_blocks import NodeBlocks


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
