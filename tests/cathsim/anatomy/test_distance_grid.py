"""The distance grid's interpolation."""

import numpy as np
import pytest

from cathsim.anatomy import SignedDistanceGrid

SLOPE = np.array([0.5, -0.3, 0.2])


@pytest.fixture(scope="module")
def linear() -> SignedDistanceGrid:
    origin = np.array([0.01, -0.02, 0.03])
    axes = np.meshgrid(np.arange(6), np.arange(7), np.arange(8), indexing="ij")
    points = origin + np.stack(axes, axis=-1) * 2e-3
    return SignedDistanceGrid((points @ SLOPE).astype(np.float32), origin, 2e-3)


def test_trilinear_interpolation_reproduces_a_linear_field(linear):
    rng = np.random.default_rng(0)
    low, high = linear.bounds
    points = rng.uniform(low, high, (4, 50, 3))
    assert linear.sample(points).shape == (4, 50)
    assert linear.sample(points) == pytest.approx(points @ SLOPE, abs=1e-8)
    inner = rng.uniform(low + 2e-3, high - 2e-3, (50, 3))
    assert linear.gradient(inner) == pytest.approx(np.broadcast_to(SLOPE, (50, 3)), abs=1e-5)


def test_beyond_the_border_the_border_counts(linear):
    low, high = linear.bounds
    assert linear.sample(low - 1.0) == pytest.approx(linear.values[0, 0, 0])
    assert linear.sample(high + 1.0) == pytest.approx(linear.values[-1, -1, -1])


def test_lattice_points_have_their_own_values(linear):
    assert linear.sample(linear.coordinates([2, 3, 4])) == pytest.approx(linear.values[2, 3, 4], abs=1e-9)


def test_bad_input_is_refused(linear):
    with pytest.raises(ValueError, match=r"points must have shape \(..., 3\), got \(2,\)"):
        linear.sample([0.0, 1.0])
    with pytest.raises(ValueError, match="at least 2 x 2 x 2"):
        SignedDistanceGrid(np.zeros((1, 4, 4), np.float32), np.zeros(3), 1e-3)
    with pytest.raises(ValueError, match="spacing must be positive"):
        SignedDistanceGrid(np.zeros((4, 4, 4), np.float32), np.zeros(3), 0.0)
    with pytest.raises(ValueError, match="read-only"):
        linear.values[0, 0, 0] = 1.0


def test_a_grid_of_the_nodes_near_a_lumen_is_that_of_the_dense_array():
    axes = np.meshgrid(*[np.arange(-20, 21) * 1e-3] * 3, indexing="ij")
    values = np.maximum(6e-3 - np.sqrt(sum(x**2 for x in axes)), -0.01).astype(np.float32)
    dense = SignedDistanceGrid(values, [-0.02] * 3, 1e-3)
    near = np.argwhere(values > -0.01)
    sparse = SignedDistanceGrid.from_nodes(near, values[tuple(near.T)], values.shape, [-0.02] * 3, 1e-3)
    points = np.random.default_rng(1).uniform(-0.022, 0.022, (2000, 3))
    assert np.array_equal(sparse.sample(points), dense.sample(points))
    assert np.array_equal(sparse.values, values)
    assert np.array_equal(sparse.inside_box(), [[15] * 3, [25] * 3])
    assert np.array_equal(sparse.silhouette(1), values.max(axis=1))
    assert sparse.thickness(2)[20, 20] == pytest.approx(0.012, abs=1e-5)
    assert np.array_equal(sparse.offset(1e-3).moved([0, 0, 0.01]).values, values + np.float32(1e-3))
    assert sparse.moved([0, 0, 0.01]).sample([0, 0, 0.01]) == pytest.approx(6e-3)
    assert np.array_equal(sparse.coarser(3).values, values[::3, ::3, ::3])
    assert np.array_equal(sparse.coarser(3).coordinates([1, 2, 3]), sparse.coordinates([3, 6, 9]))


def test_nodes_below_the_clamp_are_refused():
    nodes = {"shape": (4, 4, 4), "origin": np.zeros(3), "spacing": 1e-3}
    with pytest.raises(ValueError, match=r"below that outside, -0\.01 m; the least is -0\.02 m"):
        SignedDistanceGrid.from_nodes([[1, 1, 1]], [-0.02], **nodes)
    with pytest.raises(ValueError, match="must be negative"):
        SignedDistanceGrid.from_nodes([[1, 1, 1]], [0.02], **nodes, outside=0.0)
