"""Small hollows in the wall, cut off from the lumen: what is left of a bridge between two vessels, or of a speck."""

from __future__ import annotations

import numpy as np

from cathsim.anatomy.distance_grid import SignedDistanceGrid
from cathsim.lattice.node_set import NodeSet
from cathsim.presets import WIRE_RADIUS

LARGEST = 2e-7  # m^3, 0.2 ml: a larger one may be a vessel, and is for the check of the lumen to report
SPECK = 8  # nodes: what is smaller is rounding at an edge, not a chamber
_NEIGHBOURS = 6  # nodes of a hollow that a node is compared with


def fill_chambers(
    grid: SignedDistanceGrid, largest: float = LARGEST, clearance: float = WIRE_RADIUS
) -> SignedDistanceGrid:
    """The grid without small hollows that no wire can get into.

    Nodes further than `clearance` from the wall that hang together are a chamber. All but the largest chamber are
    filled as far as their volume is below a limit; those of less than `SPECK` nodes stay.

    Args:
        largest: m^3.
        clearance: m, the wire's radius.

    Returns:
        Another grid on the same lattice, or the same where there is nothing to fill.
    """
    from scipy.spatial import cKDTree

    free = NodeSet.where(grid.blocks, lambda values: values > clearance)
    if not len(free):
        return grid
    parts = free.parts()
    sizes = np.bincount(parts)
    lumen = int(np.argmax(sizes))
    hollow = (sizes >= SPECK) & (sizes * grid.spacing**3 < largest)
    hollow[lumen] = False
    if not hollow.any():
        return grid
    inside = hollow[parts]
    radii = np.append(free.values[inside] + grid.spacing, 0.0)  # of none that is so near: infinitely far away
    reach = float(radii.max())
    indices, values = grid.blocks.where(lambda values: values > -reach)
    away, nearest = cKDTree(grid.coordinates(free.indices[inside])).query(
        grid.coordinates(indices), k=range(1, _NEIGHBOURS + 1), distance_upper_bound=2 * reach
    )
    filled = (away - radii[nearest]).min(axis=1).astype(np.float32)
    number = free.numbers.nodes.reshape(-1)[free.numbers.positions(indices)]
    changed = (filled < values) & ((number < 0) | (parts[number] != lumen))
    return grid.with_values(indices[changed], filled[changed])
