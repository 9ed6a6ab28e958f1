"""Distance to a target along the lumen: a field on the grid, and arc length through the centreline graph."""

from __future__ import annotations

import ctypes

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cathsim.anatomy.distance_grid import SignedDistanceGrid, bounding_box
from cathsim.anatomy.vessel_tree import VesselTree

MARGIN = 4e-3  # m outside the lumen up to which the field continues its nearest inside value
_SEED_RADIUS = 2e-3  # m: within this ball about the target the distance is the straight one


def geodesic_field(grid: SignedDistanceGrid, target: ArrayLike) -> NDArray[np.float32]:
    """Shortest distance to a target (3,) m inside the lumen, by fast marching.

    Returns:
        (nx, ny, nz) float32 m, finite everywhere. Up to MARGIN outside the wall it continues the nearest inside values;
        further out, and where the target cannot be reached, it holds its largest value.

    Raises:
        ValueError: the target lies outside the lumen.
    """
    target = np.asarray(target, dtype=np.float64)
    depth = float(grid.sample(target))
    if depth <= 0:
        raise ValueError(f"a geodesic target must lie inside the lumen, got {target.tolist()} m, {-depth:g} m outside.")
    seed = max(min(_SEED_RADIUS, 0.8 * depth), 1.01 * grid.spacing)
    inside = grid.values > 0
    box = bounding_box(inside)
    inside = inside[box]
    axes = [grid.origin[k] + np.arange(grid.shape[k])[box[k]] * grid.spacing - target[k] for k in range(3)]
    straight = np.sqrt(axes[0][:, None, None] ** 2 + axes[1][None, :, None] ** 2 + axes[2][None, None, :] ** 2)
    distance = _march(np.where(straight < seed, straight, np.inf), inside, grid.spacing)
    reached = inside & np.isfinite(distance)
    field = np.full(grid.shape, np.inf, dtype=np.float32)
    field[box][reached] = distance[reached]
    return _continue_outwards(field, float(distance[reached].max()), grid)


def _march(seeded: NDArray[np.float64], inside: NDArray[np.bool_], spacing: float) -> NDArray[np.float64]:
    """Distances inside the lumen, m, from those that are finite already; infinite where there is no way."""
    from cathsim.contact.native import address, library

    distance = np.ascontiguousarray(seeded, dtype=np.float64)
    free, accepted = np.ascontiguousarray(inside, dtype=np.uint8), np.zeros(inside.shape, dtype=np.uint8)
    size = np.array(inside.shape, dtype=np.int32)
    march = library().cathsim_march
    if march(address(size), ctypes.c_double(spacing), address(free), address(accepted), address(distance)):
        raise MemoryError(f"no memory left for the distances of {inside.size} grid nodes: use a coarser resolution")
    return distance


def _continue_outwards(field: NDArray[np.float32], farthest: float, grid: SignedDistanceGrid) -> NDArray[np.float32]:
    """Fills the lattice outside the lumen, layer by layer outwards, with the mean of known neighbours."""
    strides = np.array([grid.shape[1] * grid.shape[2], grid.shape[2], 1])
    around = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3) @ strides
    around = around[around != 0]
    flat, depth = field.reshape(-1), -grid.values.reshape(-1)
    open_ = np.flatnonzero((depth < MARGIN + grid.spacing) & ~np.isfinite(flat))
    layers = int(np.ceil(MARGIN / grid.spacing)) + 1
    for layer in range(1, layers + 1):
        chosen = open_[depth[open_] < layer * grid.spacing]
        total = np.zeros(len(chosen), dtype=np.float32)
        count = np.zeros(len(chosen), dtype=np.float32)
        for offset in around:
            neighbour = flat[chosen + offset]  # the grid's padding keeps every neighbour on the lattice
            finite = np.isfinite(neighbour)
            count += finite
            total += np.where(finite, neighbour, 0)
        reached = count > 0
        flat[chosen[reached]] = total[reached] / count[reached]
        open_ = open_[~np.isfinite(flat[open_])]
    flat[~np.isfinite(flat)] = farthest
    return field


def graph_distance(tree: VesselTree, start: str, start_arc: ArrayLike, branch: str, arc: float) -> NDArray[np.float64]:
    """Arc length (...,) m of the only way through the centreline graph between two places.

    Args:
        start, start_arc: branch of the first places, and (...,) m along it.
        branch, arc: branch of the second place, and m along it.
    """
    start_arc = np.asarray(start_arc, dtype=np.float64)
    if start == branch:
        return np.abs(start_arc - arc)
    chain = tree.ancestry(branch)
    if start in chain:
        child = tree[chain[chain.index(start) + 1]]
        return np.abs(start_arc - child.parent_arc) + graph_distance(tree, child.name, 0.0, branch, arc)
    here = tree[start]
    assert here.parent is not None  # the root is in every chain
    return start_arc + graph_distance(tree, here.parent, here.parent_arc, branch, arc)


def centreline_path(tree: VesselTree, start: tuple[str, float], end: tuple[str, float]) -> NDArray[np.float64]:
    """Points (n, 3) m of the centreline graph, about 1 mm apart, between two places: branch and arc length (m) each."""
    first, last = tree.ancestry(start[0]), tree.ancestry(end[0])
    shared = max(i for i in range(min(len(first), len(last))) if first[i] == last[i])

    def climb(chain: tuple[str, ...], arc: float) -> tuple[list[NDArray[np.float64]], float]:
        pieces = []
        for name in reversed(chain[shared + 1 :]):
            pieces.append(_stretch(tree, name, arc, 0.0))
            arc = tree[name].parent_arc
        return pieces, arc

    up, leave = climb(first, start[1])
    down, arrive = climb(last, end[1])
    middle = _stretch(tree, first[shared], leave, arrive)
    path = np.concatenate([*up, middle, *[piece[::-1] for piece in reversed(down)]])
    repeated = np.linalg.norm(np.diff(path, axis=0), axis=1) < 1e-9
    return path[np.concatenate([[True], ~repeated])]


def _stretch(tree: VesselTree, name: str, start: float, end: float) -> NDArray[np.float64]:
    return tree[name].point_at(np.linspace(start, end, max(int(np.ceil(abs(end - start) / 1e-3)), 1) + 1))
