"""Numbered nodes know their neighbours and the parts that they form."""

from itertools import product

import numpy as np
from scipy import ndimage

from cathsim.lattice.node_blocks import NodeBlocks
from cathsim.lattice.node_set import NodeSet

SHAPE = (19, 23, 30)


def scattered(seed: int = 0) -> np.ndarray:
    """Blobs of random size, several of which do not touch."""
    noise = np.random.default_rng(seed).normal(size=SHAPE)
    return ndimage.gaussian_filter(noise, 1.5).astype(np.float32)


def test_numbers_follow_c_order_and_neighbours_are_found() -> None:
    values = scattered()
    chosen = NodeSet.where(NodeBlocks.from_dense(values), lambda value: value > 0.05)
    assert np.array_equal(chosen.indices, np.argwhere(values > 0.05))
    numbers = np.full([n + 2 for n in SHAPE], -1)
    numbers[1:-1, 1:-1, 1:-1][values > 0.05] = np.arange(len(chosen))
    for offset in product((-1, 0, 1), repeat=3):  # also across the lattice's border, where there is none
        expected = numbers[tuple((chosen.indices + 1 + offset).T)]
        assert np.array_equal(chosen.neighbours(slice(None), offset), expected)
    assert chosen.number_at(chosen.indices[7]) == 7


def test_parts_are_those_of_a_labelled_image() -> None:
    values = scattered(1)
    chosen = NodeSet.where(NodeBlocks.from_dense(values), lambda value: value > 0.05)
    labels, count = ndimage.label(values > 0.05)
    parts = chosen.parts()
    assert len(np.unique(parts)) == count > 3
    pairs = {(int(a), int(b)) for a, b in zip(parts, labels[values > 0.05], strict=True)}
    assert len(pairs) == count


def test_values_spread_over_the_lattice() -> None:
    values = scattered(2)
    chosen = NodeSet.where(NodeBlocks.from_dense(values), lambda value: value > 0.05)
    spread = chosen.spread(chosen.values, -3.0)
    assert np.array_equal(spread.dense(), np.where(values > 0.05, values, np.float32(-3.0)))
