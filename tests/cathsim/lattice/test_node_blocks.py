"""Sparse lattices: blocks of nodes, sets of nodes, parts."""

import pickle
from itertools import product

import numpy as np
import pytest
from scipy import ndimage

from cathsim.lattice.node_blocks import NodeBlocks
from cathsim.lattice.node_set import NodeSet

SHAPE = (21, 40, 33)  # none but one a multiple of a block's edge
CLAMP = -0.01


@pytest.fixture(scope="module")
def values() -> np.ndarray:
    """Distances inside a bent tube through a corner of the lattice, clamped elsewhere."""
    axes = np.meshgrid(*(np.arange(n, dtype=float) for n in SHAPE), indexing="ij")
    distance = 4.0 - np.hypot(axes[0] - 3 - 0.01 * axes[1] ** 2, axes[2] - 30)
    return np.maximum(1e-3 * distance, CLAMP).astype(np.float32)


@pytest.fixture(scope="module")
def blocks(values: np.ndarray) -> NodeBlocks:
    return NodeBlocks.from_dense(values)


def test_round_trip_and_only_what_differs_is_stored(values: np.ndarray, blocks: NodeBlocks) -> None:
    assert np.array_equal(blocks.dense(), values)
    assert blocks.constant == np.float32(CLAMP)
    assert 0 < len(blocks.places) < 0.8 * blocks.table.size
    assert blocks.nbytes == blocks.table.nbytes + blocks.nodes.nbytes


def test_a_box_is_that_of_the_dense_array(values: np.ndarray, blocks: NodeBlocks) -> None:
    for box in (np.s_[3:9, 0:40, 25:33], np.s_[7:8, 15:17, :], np.s_[5:5, :, :], np.s_[-4:, :-30, 8:16]):
        assert np.array_equal(blocks.dense(box), values[box])
    with pytest.raises(ValueError, match="three slices without a step"):
        blocks.dense(np.s_[::2, :, :])


def test_nodes_that_fulfil_a_condition_come_in_c_order(values: np.ndarray, blocks: NodeBlocks) -> None:
    for least in (0.0, -0.005, -1.0):  # the last one holds for the constant too
        indices, found = blocks.where(lambda value, least=least: value > least)
        assert np.array_equal(indices, np.argwhere(values > least))
        assert np.array_equal(found, values[values > least])


def test_values_between_nodes_are_those_of_the_eight_around(values: np.ndarray, blocks: NodeBlocks) -> None:
    limit = np.array(SHAPE) - 1
    index = np.random.default_rng(0).uniform(-3, limit + 3, (500, 3))
    index[:50] = np.rint(index[:50])
    index[50] = limit
    clipped = np.clip(index, 0, limit)
    base = np.minimum(clipped.astype(int), limit - 1)
    expected = np.zeros(len(index))
    for corner in product((0, 1), repeat=3):
        weight = np.where(corner, clipped - base, 1 - (clipped - base)).prod(axis=1)
        expected += weight * values[tuple((base + corner).T)]
    assert np.allclose(blocks.interpolated(index), expected, rtol=0, atol=1e-15)
    assert np.isnan(blocks.interpolated(np.array([1.0, np.nan, 1.0])))
    copy = pickle.loads(pickle.dumps(blocks))
    assert np.array_equal(copy.interpolated(index.reshape(5, 100, 3)), blocks.interpolated(index).reshape(5, 100))
    with pytest.raises(TypeError, match="float32"):
        NodeBlocks.from_dense(np.arange(27, dtype=np.int32).reshape(3, 3, 3)).interpolated(index)


def test_parts_are_those_of_a_labelled_image() -> None:
    noise = np.random.default_rng(1).normal(size=(19, 23, 30))
    values = ndimage.gaussian_filter(noise, 1.5).astype(np.float32)  # blobs, several of which do not touch
    chosen = NodeSet.where(NodeBlocks.from_dense(values), lambda value: value > 0.05)
    labels, count = ndimage.label(values > 0.05)
    parts = chosen.parts()
    assert len(np.unique(parts)) == count > 3
    pairs = {(int(a), int(b)) for a, b in zip(parts, labels[values > 0.05], strict=True)}
    assert len(pairs) == count
