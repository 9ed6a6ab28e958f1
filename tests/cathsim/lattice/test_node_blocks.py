"""Values in blocks are those of the dense lattice, whatever part of it is stored."""

import pickle
from itertools import product

import numpy as np
import pytest

from cathsim.lattice.node_blocks import STRIDES, NodeBlocks

SHAPE = (21, 40, 33)  # none but one a multiple of a block's edge
CLAMP = -0.01


def near_a_line() -> np.ndarray:
    """Distances inside a bent tube through a corner of the lattice, clamped elsewhere."""
    axes = np.meshgrid(*(np.arange(n, dtype=float) for n in SHAPE), indexing="ij")
    distance = 4.0 - np.hypot(axes[0] - 3 - 0.01 * axes[1] ** 2, axes[2] - 30)
    return np.maximum(1e-3 * distance, CLAMP).astype(np.float32)


@pytest.fixture(scope="module")
def values() -> np.ndarray:
    return near_a_line()


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


def test_nodes_in_any_order_give_the_same_blocks(values: np.ndarray, blocks: NodeBlocks) -> None:
    order = np.random.default_rng(0).permutation(np.argwhere(values > CLAMP))
    built = NodeBlocks.from_nodes(order, values[tuple(order.T)], SHAPE, CLAMP)
    assert np.array_equal(built.table, blocks.table)
    assert np.array_equal(built.nodes, blocks.nodes)


def test_every_stored_node_has_its_neighbours_beside_it(values: np.ndarray, blocks: NodeBlocks) -> None:
    """3 x 3 x 3 nodes around any inner node lie within the middle one's block."""
    inner = np.argwhere(np.ones([n - 2 for n in SHAPE], bool)) + 1
    flat = blocks.nodes.reshape(-1)
    for offset in product((-1, 0, 1), repeat=3):
        found = flat[blocks.positions(inner) + int(np.dot(offset, STRIDES))]
        assert np.array_equal(found, values[tuple((inner + offset).T)])


def test_nodes_that_fulfil_a_condition_come_in_c_order(values: np.ndarray, blocks: NodeBlocks) -> None:
    for least in (0.0, -0.005, -1.0):  # the last one holds for the constant too
        indices, found = blocks.where(lambda value, least=least: value > least)
        assert np.array_equal(indices, np.argwhere(values > least))
        assert np.array_equal(found, values[values > least])


def test_box_of_nodes_that_fulfil_a_condition(values: np.ndarray, blocks: NodeBlocks) -> None:
    for least in (0.0, -0.005, -1.0):
        found = np.argwhere(values > least)
        box = blocks.box_where(lambda value, least=least: value > least)
        assert box.tolist() == [found.min(axis=0).tolist(), found.max(axis=0).tolist()]
    with pytest.raises(ValueError, match="zero-size"):
        blocks.box_where(lambda value: value > 1.0)


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


@pytest.mark.parametrize("stride", [1, 2, 3, 5])
def test_coarser_lattice_holds_every_nth_node(values: np.ndarray, blocks: NodeBlocks, stride: int) -> None:
    assert np.array_equal(blocks.coarser(stride).dense(), values[::stride, ::stride, ::stride])


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_views_along_an_axis(values: np.ndarray, blocks: NodeBlocks, axis: int) -> None:
    assert np.array_equal(blocks.maximum_along(axis), values.max(axis=axis))
    inside = blocks.sum_along(axis, lambda value: value > 0)
    assert np.array_equal(inside, (values > 0).sum(axis=axis))


def test_a_lattice_of_one_value_stores_nothing() -> None:
    blocks = NodeBlocks.from_dense(np.full((9, 3, 17), 0.25, np.float32))
    assert len(blocks.nodes) == 1
    assert (blocks.dense() == 0.25).all()
    assert len(blocks.where(lambda value: value > 0)[0]) == 9 * 3 * 17
    empty = NodeBlocks.from_nodes(np.zeros((0, 3), int), np.zeros(0, np.float32), (5, 6, 7), -1.0)
    assert (empty.dense() == -1.0).all()


def test_it_never_changes(blocks: NodeBlocks) -> None:
    with pytest.raises(ValueError, match="read-only"):
        blocks.nodes[0, 0, 0, 0] = 1.0


@pytest.mark.parametrize(
    ("indices", "values", "shape", "message"),
    [
        ([[0, 0, 9]], [1.0], (4, 4, 9), r"within a lattice of \(4, 4, 9\) nodes"),
        ([[0, -1, 0]], [1.0], (4, 4, 4), "within a lattice"),
        ([[0, 0, 0]], [1.0, 2.0], (4, 4, 4), r"values must have shape \(1,\)"),
        ([[0, 0]], [1.0], (4, 4, 4), r"whole numbers of shape \(n, 3\)"),
        ([[0.5, 0, 0]], [1.0], (4, 4, 4), "whole numbers"),
        ([[0, 0, 0]], [1.0], (4, 0, 4), "at least one each"),
    ],
)
def test_impossible_nodes_are_refused(indices: list, values: list, shape: tuple, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        NodeBlocks.from_nodes(indices, np.array(values, np.float32), shape, -1.0)
