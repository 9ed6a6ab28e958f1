"""The wall between two vessels that lie side by side, as thick as tissue is, and hollows in it that are no lumen."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.distance_grid import SignedDistanceGrid
from cathsim.lattice.node_set import NodeSet, linked_parts
from cathsim.presets import WIRE_RADIUS

THINNEST = 3e-3  # m between two lumens: the wall of an aorta, about 2 mm, and that of a branch, about 1 mm
NARROWEST = 4e-3  # m of a vessel's width, below which it gives nothing to a wall
_SHELL = 1.5  # spacings from the wall, up to which the lumen's nodes look for another lumen behind it
_FIRST, _STEP = 2e-4, 1e-4  # m behind the wall, where they look
_WIDEST, _WIDTH_STEP = 40e-3, 5e-4  # m of a vessel's width, as far as it matters
_LEAST_SLOPE = 0.5  # of a distance: less is a medial axis, which has no direction
_ROUND = 3.5e-3  # m: a wall that ends nearer than this is the edge of something
_LINK = 2.5e-3  # m between two places of one wall
_NEIGHBOURS = 6  # balls that a node is compared with

Array = NDArray[np.float64]


LARGEST = 2e-7  # m^3, 0.2 ml: a larger one may be a vessel, and is for the check of the lumen to report
SPECK = 8  # nodes: what is smaller is rounding at an edge, not a chamber


def thicken_between_lumens(grid: SignedDistanceGrid) -> SignedDistanceGrid:
    """The grid with walls of a thickness at least wherever there is lumen on both sides.

    What is missing is taken from the vessels on both sides, half from each; a narrow vessel gives less. A low ridge,
    and what floats in the lumen, stay as they are: both sides of them are one lumen everywhere. A wall so thin that
    the lattice has nothing of it is none.

    Returns:
        Another grid on the same lattice, or the same where nothing is too thin.
    """
    from scipy.spatial import cKDTree

    centres, radii = _balls(grid, THINNEST, NARROWEST)
    if not len(centres):
        return grid
    indices, values = grid.blocks.where(lambda values: values > -THINNEST)
    away, nearest = cKDTree(centres).query(
        grid.coordinates(indices), k=range(1, _NEIGHBOURS + 1), distance_upper_bound=THINNEST + _WIDEST / 2
    )
    radius = np.append(radii, 0.0)[nearest]  # of none that is so near: infinitely far away
    filled = (away - radius).min(axis=1).astype(np.float32)
    changed = filled < values
    return grid.with_values(indices[changed], filled[changed])


def walls_between_lumens(grid: SignedDistanceGrid, thickest: float) -> tuple[Array, Array]:
    """Balls that fill the walls between two lumens that are no thicker than that.

    Args:
        thickest: m.

    Returns:
        Their centres (n, 3) m, halfway between the lumens, and their radii (n,) m.
    """
    return _balls(grid, thickest, np.inf)


def _balls(grid: SignedDistanceGrid, thinnest: float, narrowest: float) -> tuple[Array, Array]:
    """Balls that fill every wall between lumens up to a thickness: centres (n, 3) m and radii (n,) m."""
    indices, _ = grid.blocks.where(lambda values: (values > 0) & (values < _SHELL * grid.spacing))
    points = grid.coordinates(indices)
    inward = grid.gradient(points)
    slope = np.linalg.norm(inward, axis=1)
    steep = slope > _LEAST_SLOPE
    points, inward = points[steep], inward[steep] / slope[steep, None]
    foot = points - grid.sample(points)[:, None] * inward
    thickness = _first(grid, foot, -inward, np.arange(_FIRST, thinnest, _STEP), lumen=True)
    thin = np.isfinite(thickness)
    foot, inward, thickness = foot[thin], inward[thin], thickness[thin]
    behind = foot - thickness[:, None] * inward
    whole = _with_neighbours(0.5 * (foot + behind), _apart(grid, foot, behind))
    foot, inward, thickness, behind = foot[whole], inward[whole], thickness[whole], behind[whole]
    steps = np.arange(_WIDTH_STEP, _WIDEST, _WIDTH_STEP)
    widths = [
        np.minimum(_first(grid, start, way, steps, lumen=False), _WIDEST) - _WIDTH_STEP
        for start, way in ((foot, inward), (behind, -inward))
    ]
    own, other = (np.clip(0.5 * (thinnest - thickness), 0.0, np.maximum(width - narrowest, 0.0)) for width in widths)
    return 0.5 * (foot + behind + (own - other)[:, None] * inward), 0.5 * (thickness + own + other)


def _first(grid: SignedDistanceGrid, start: Array, way: Array, steps: Array, *, lumen: bool) -> Array:
    """The first of some steps (m) along a way (n, 3) at which there is lumen, or none, once it was the other; inf."""
    distances = np.full(len(start), np.inf)
    been = np.zeros(len(start), dtype=bool)
    for step in steps:
        met = (grid.sample(start + step * way) > 0) == lumen
        distances[been & met & np.isinf(distances)] = step
        been |= ~met
    return distances


def _apart(grid: SignedDistanceGrid, first: Array, second: Array) -> NDArray[np.bool_]:
    """Whether no way leads from one side of a wall (n, 3) m to the other within a cube of `_ROUND` about it."""
    from scipy.ndimage import label

    reach = max(round(_ROUND / grid.spacing), 2)
    steps = np.arange(-reach, reach + 1)
    nodes = np.rint((0.5 * (first + second) - grid.origin) / grid.spacing)
    cube = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1)
    apart = np.ones(len(first), dtype=bool)
    for place, (node, one, other) in enumerate(zip(nodes, first, second, strict=True)):
        at = grid.coordinates(node + cube)
        parts, _ = label(grid.sample(at) > 0)
        sides = [_nearest_part(parts, at, point) for point in (one, other)]
        apart[place] = 0 in sides or sides[0] != sides[1]
    return apart


def _with_neighbours(places: Array, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Chosen places (n, 3) m, and all that hang together with them by steps of `_LINK`."""
    from scipy.spatial import cKDTree

    pairs = cKDTree(places).query_pairs(_LINK, output_type="ndarray")
    parts = linked_parts(pairs[:, 0], pairs[:, 1], len(places))
    return np.isin(parts, parts[mask])


def _nearest_part(parts: NDArray[np.int32], at: Array, point: Array) -> int:
    """The part of the lumen that is nearest to a point (3,) m, 0 where there is none."""
    inside = parts > 0
    if not inside.any():
        return 0
    return int(parts[inside][np.argmin(((at[inside] - point) ** 2).sum(axis=-1))])


def fill_chambers(grid: SignedDistanceGrid) -> SignedDistanceGrid:
    """The grid without small hollows that no wire can get into.

    Nodes further than a wire's radius from the wall that hang together are a chamber. All but the largest chamber are
    filled as far as their volume is below `LARGEST`; those of less than `SPECK` nodes stay.

    Returns:
        Another grid on the same lattice, or the same where there is nothing to fill.
    """
    from scipy.spatial import cKDTree

    free = NodeSet.where(grid.blocks, lambda values: values > WIRE_RADIUS)
    if not len(free):
        return grid
    parts = free.parts()
    sizes = np.bincount(parts)
    lumen = int(np.argmax(sizes))
    hollow = (sizes >= SPECK) & (sizes * grid.spacing**3 < LARGEST)
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
