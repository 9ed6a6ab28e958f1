"""Lattices and sets of their nodes as the native code reads them."""

from __future__ import annotations

import ctypes

from cathsim.lattice.node_blocks import NodeBlocks
from cathsim.lattice.node_set import NodeSet


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


class NodeSetStruct(ctypes.Structure):
    """Some nodes of a lattice (struct NodeSet of lattice.h)."""

    _fields_ = (("count", ctypes.c_int32), ("numbers", ctypes.c_void_p), ("positions", ctypes.c_void_p))

    @classmethod
    def of(cls, nodes: NodeSet) -> NodeSetStruct:
        """The struct of a set, which must outlive its use."""
        return cls(len(nodes), nodes.numbers.nodes.ctypes.data, nodes.positions.ctypes.data)
