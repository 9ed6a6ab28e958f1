"""Distance to a target along the lumen: a field on the grid, and arc length through the centreline graph."""

from __future__ import annotations

import ctypes

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cathsim.anatomy.distance_grid import LatticeField, SignedDistanceGrid
from cathsim.anatomy.vessel_tree import VesselTree
from cathsim.lattice.node_set import NodeSet, NodeSetStruct

MARGIN = 4e-3  # m outside the lumen up to which the field continues its nearest inside value
_SEED_RADIUS = 2e-3  # m: within this ball about the target the distance is the straight one


def geodesic_field(grid: SignedDistanceGrid, target: ArrayLike) -> LatticeField:
    """Shortest distance to a target (3,) m inside the lumen, by fast marching.

    Returns:
        On the grid's lattice, m, finite everywhere. Up to MARGIN outside the wall it continues the nearest inside
        values; further out, and where the target cannot be reached, it holds its largest value.

    Raises:
        ValueError: the target lies outside the lumen.
    """
    target = np.asarray(target, dtype=np.float64)
    depth = float(grid.sample(target))
    if depth <= 0:
        raise ValueError(f"a geodesic target must lie inside the lumen, got {target.tolist()} m, {-depth:g} m outside.")
    seed = max(min(_SEED_RADIUS, 0.8 * depth), 1.01 * grid.spacing)
    clamp = grid.blocks.constant
    band = NodeSet.where(
        grid.blocks, lambda values: (-values < MARGIN + grid.spacing) & ((values > clamp) | (values > 0))
    )
    inside = band.values > 0
    axes = [grid.origin[k] + np.arange(grid.shape[k]) * grid.spacing - target[k] for k in range(3)]
    distance = np.zeros(len(band))
    for k, axis in enumerate(axes):
        distance += np.square(axis)[band.indices[:, k]]
    np.sqrt(distance, out=distance)
    distance[~(inside & (distance < seed))] = np.inf
    _march(distance, band, inside, grid.spacing)
    farthest = float(distance[np.isfinite(distance)].max())
    field = distance.astype(np.float32)
    del distance
    _continue_outwards(field, band, grid.spacing)
    field[~np.isfinite(field)] = farthest
    return LatticeField(band.spread(field, farthest), grid.origin, grid.spacing)


def _march(distance: NDArray[np.float64], band: NodeSet, inside: NDArray[np.bool_], spacing: float) -> None:
    """Fills in the distances (n,) at the lumen's nodes, m, from those that are finite; infinite where is no way."""
    from cathsim.contact.native import address, library

    accepted = np.zeros(len(band), dtype=np.uint8)
    nodes = ctypes.byref(NodeSetStruct.of(band))
    march = library().cathsim_march
    if march(nodes, address(inside), ctypes.c_double(spacing), address(accepted), address(distance)):
        raise MemoryError(f"no memory left for the distances of {len(band)} grid nodes: use a coarser resolution")


def _continue_outwards(field: NDArray[np.float32], band: NodeSet, spacing: float) -> None:
    """Fills a field (n,) on a band of nodes outside the lumen, layer by layer, with the mean of known neighbours."""
    from cathsim.contact.native import address, library

    nodes = NodeSetStruct.of(band)
    depth, open_ = -band.values, np.flatnonzero(~np.isfinite(field)).astype(np.int32)
    layers = int(np.ceil(MARGIN / spacing)) + 1
    for layer in range(1, layers + 1):
        front = open_[depth[open_] < layer * spacing]
        means = np.empty(len(front), dtype=np.float32)
        arrays = (address(array) for array in (front, field, means))
        library().cathsim_continue_outwards(ctypes.byref(nodes), len(front), *arrays)
        open_ = open_[~np.isfinite(field[open_])]


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
    first_branch = tree[start]
    assert first_branch.parent is not None  # the root is in every chain
    return start_arc + graph_distance(tree, first_branch.parent, first_branch.parent_arc, branch, arc)
