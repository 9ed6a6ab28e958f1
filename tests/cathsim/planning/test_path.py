"""Paths in the lumen: optimal on the lattice, taut in the open, off the wall in a bend."""

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from cathsim.anatomy.distance_grid import SignedDistanceGrid
from cathsim.planning.path import LumenPath, UnreachableError, picture, plan_path, shortest_lattice_path, smooth_path

SPACING = 1e-3


def bent_tube(radius=0.006, bend=0.03):
    """Half a torus in the x-z plane about the origin, closed at x = 0 below."""
    half = bend + radius + 3e-3
    x, y, z = np.meshgrid(
        np.arange(-half, half, SPACING),
        np.arange(-radius - 3e-3, radius + 3e-3, SPACING),
        np.arange(-5e-3, half, SPACING),
        indexing="ij",
    )
    values = np.minimum(radius - np.hypot(np.hypot(x, z) - bend, y), z + 2e-3)
    origin = np.array([x.min(), y.min(), z.min()])
    return SignedDistanceGrid(values.astype(np.float32), origin, SPACING)


def maze(seed, shape=(9, 8, 7)):
    """Free points at random, with a distance that varies, for search problems without any geometry to lean on."""
    generator = np.random.default_rng(seed)
    values = generator.uniform(-0.002, 0.004, shape).astype(np.float32)
    values[0, 0, 0] = values[-1, -1, -1] = 0.003
    return SignedDistanceGrid(values, np.zeros(3), SPACING)


def brute_force(grid, clearance, weight):
    """Least cost from the first to the last lattice point over all pairs of neighbours."""
    index = np.argwhere(grid.values >= clearance)
    apart = np.abs(index[:, None] - index[None]).max(axis=2)
    i, j = np.nonzero(apart == 1)
    w = weight[tuple(index.T)]
    cost = np.linalg.norm(index[i] - index[j], axis=1) * SPACING * (w[i] + w[j]) / 2
    graph = coo_array((cost, (i, j)), shape=(len(index), len(index))).tocsr()
    return dijkstra(graph, indices=0)[-1]


def cost_of(path, grid, weight):
    index = np.rint((path.points - grid.origin) / grid.spacing).astype(int)
    w = weight[tuple(index.T)]
    return (np.linalg.norm(np.diff(path.points, axis=0), axis=1) * (w[1:] + w[:-1]) / 2).sum()


@pytest.mark.parametrize("preferred", [0.0, 0.003])
@pytest.mark.parametrize("seed", range(4))
def test_search_is_optimal(seed, preferred):
    grid = maze(seed)
    weight = np.ones(grid.shape)
    if preferred:
        weight += 4.0 * np.clip(1 - grid.values / preferred, 0, 1)
    ends = grid.coordinates([[0, 0, 0], np.array(grid.shape) - 1])
    expected = brute_force(grid, 0.0005, weight)
    if not np.isfinite(expected):
        with pytest.raises(UnreachableError):
            shortest_lattice_path(grid, *ends, clearance=0.0005)
        return
    path = shortest_lattice_path(grid, *ends, clearance=0.0005, preferred_clearance=preferred, aversion=4.0)
    assert cost_of(path, grid, weight) == pytest.approx(expected, rel=1e-9)
    np.testing.assert_allclose(path.points[[0, -1]], ends)
    steps = np.abs(np.diff(path.points, axis=0)).max(axis=1)
    np.testing.assert_allclose(steps, SPACING, rtol=1e-6)


def test_in_a_bend_the_path_hugs_the_inner_wall():
    grid = bent_tube()
    start, target = np.array([-0.03, 0, 0]), np.array([0.03, 0, 0])
    clearance = 1e-3
    path = plan_path(grid, start, target, clearance=clearance)
    # taut string over the inner wall: tangents from both ends and the arc between
    inner = 0.03 - 0.006 + clearance
    wrap = np.pi - 2 * np.arccos(inner / 0.03)
    shortest = 2 * np.sqrt(0.03**2 - inner**2) + inner * wrap
    assert path.length == pytest.approx(shortest, rel=0.02)
    assert path.clearance(grid) > clearance - 0.05e-3
    raw = shortest_lattice_path(grid, start, target, clearance=clearance)
    assert raw.length > path.length


def test_smoothing_rounds_corners_inside_the_lumen():
    grid = bent_tube()
    corner = LumenPath([[-0.03, 0, 0], [-0.022, 0, 0.02], [0, 0, 0.0301], [0.022, 0, 0.02], [0.03, 0, 0]])
    smooth = smooth_path(corner, grid, clearance=5e-4)

    def sharpest(path):
        legs = np.diff(path.points, axis=0)
        legs /= np.linalg.norm(legs, axis=1, keepdims=True)
        return np.arccos(np.clip((legs[1:] * legs[:-1]).sum(axis=1), -1, 1)).max()

    assert sharpest(smooth) < 0.25 * sharpest(corner)
    assert smooth.clearance(grid) > 4e-4
    np.testing.assert_array_equal(smooth.points[[0, -1]], corner.points[[0, -1]])


def test_bad_ends_and_blocked_ways_are_refused():
    grid = bent_tube()
    for start, target, aversion, message in (
        ([0, 0, 0], [0.03, 0, 0], 1, r"start \(0.0, 0.0, 0.0\) mm lies outside the lumen"),
        ([-0.03, 0, 0], [0.5, 0, 0], 1, r"target .* lies outside the lumen"),
        ([np.nan, 0, 0], [0.03, 0, 0], 1, "three finite coordinates"),
        ([-0.03, 0, 0], [0.03, 0, 0], -1, r"aversion must lie in 0 to 1e\+06, got -1"),
    ):
        with pytest.raises(ValueError, match=message):
            plan_path(grid, start, target, aversion=aversion)
    blocked = np.array(grid.values)
    blocked[blocked.shape[0] // 2 - 1 : blocked.shape[0] // 2 + 2] = -0.001
    wall = SignedDistanceGrid(blocked, grid.origin, SPACING)
    with pytest.raises(UnreachableError, match=r"no way .* \(-30.0, 0.0, 0.0\) mm to \(30.0, 0.0, 0.0\) mm"):
        plan_path(wall, [-0.03, 0, 0], [0.03, 0, 0])
    with pytest.raises(ValueError, match="finite points of shape"):
        LumenPath(np.zeros((3, 2)))


def test_picture_is_a_png(tmp_path):
    pytest.importorskip("matplotlib")
    grid = bent_tube()
    file = picture(plan_path(grid, [-0.03, 0, 0], [0.03, 0, 0]), grid, tmp_path / "path.png")
    assert file.read_bytes().startswith(b"\x89PNG")
    assert file.stat().st_size > 10_000
