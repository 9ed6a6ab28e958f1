"""The lumen of a vessel tree: tubes joined by rounded ostia, closed by flat ends, as a signed distance grid."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.distance_grid import OUTSIDE, SignedDistanceGrid
from cathsim.anatomy.vessel_tree import Branch, VesselTree
from cathsim.lattice.node_blocks import STRIDES, NodeBlocks

PADDING = 7  # lattice points around the lumen
_CELL = 3  # lattice points along the edge of a block that shares one nearest-centreline query
_LAYERS = 24  # slabs of the lattice are a multiple of this thick: whole blocks and whole cells
_DENSE = 8e6  # lattice points of a slab
_BAND = 4  # lattice points from the wall within which slopes are corrected
_BATCH = 200  # blocks worked on at once, so that they stay in the processor's cache
_NEWTON_STEPS = 2
_LONGEST_STEP = 2e-3  # m: the block's nearest sample is never further off than this where it matters
_SAMPLE = 5e-4  # m between centreline samples
_BIFURCATION_ROUNDING = 0.4  # of the ostia's fillet: a bifurcation's halves overlap and would bulge
_POUCH_ROUNDING = 8e-3  # m over which a blind pouch (a saccular aneurysm) blends into its vessel

Array = NDArray[np.float64]


def build_lumen(tree: VesselTree, *, resolution: float, fillet_radius: float) -> SignedDistanceGrid:
    """Signed distance grid of a vessel tree's lumen.

    Every branch is a tube about its centreline. A smooth maximum joins the tubes and rounds the edges of the ostia; the
    result is rescaled to unit slope near the wall. Flat caps close open ends.

    Args:
        resolution: m between lattice points.
        fillet_radius: m, rounding at ostia.

    Returns:
        Grid with at least six lattice points of padding; exact to first order near the wall, clamped far outside.

    Raises:
        ValueError: the resolution is too coarse for the narrowest vessel, or not positive.
    """
    narrowest = min(float(branch.radius.min()) for branch in tree)
    if not 3e-4 <= resolution <= 0.8 * narrowest:
        raise ValueError(
            f"resolution must lie in [0.0003, {0.8 * narrowest:.3g}] m for this anatomy "
            f"(its narrowest radius is {narrowest:.3g} m), got {resolution!r}."
        )
    low, high = tree.bounds
    origin = np.floor(low / resolution - PADDING) * resolution
    shape = np.ceil((high - origin) / resolution).astype(int) + PADDING + 1
    thickness = max(_LAYERS, int(_DENSE / (shape[1] * shape[2])) // _LAYERS * _LAYERS)
    blended: list[NDArray[np.int64]] = []

    def slabs() -> Iterator[NDArray[np.float32]]:
        for first in range(0, int(shape[0]), thickness):
            field, ostia = _slab(tree, origin, shape, resolution, fillet_radius, slice(first, first + thickness))
            near = np.argwhere(ostia & (np.abs(field) < _BAND * resolution))
            near[:, 0] += first
            blended.append(near)
            # far outside the branches leave traces that nothing reads
            field[field < OUTSIDE - 1.5 * _BAND * resolution] = 2 * OUTSIDE
            yield field

    nx, ny, nz = shape.tolist()
    blocks = NodeBlocks.from_slabs(slabs(), (nx, ny, nz), 2 * OUTSIDE)
    return SignedDistanceGrid(_unit_slope(blocks, np.concatenate(blended), resolution), origin, resolution)


def _slab(
    tree: VesselTree, origin: Array, shape: Array, spacing: float, fillet_radius: float, layers: slice
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Some layers of the lattice along x: the joined tubes, and where they were blended."""
    size = (min(layers.stop, int(shape[0])) - layers.start, shape[1], shape[2])
    field = np.full(size, 2 * OUTSIDE, dtype=np.float32)
    ostia = np.zeros(size, dtype=bool)
    for branch in tree:
        region, tube = _tube(branch, tree, origin, shape, spacing, layers)
        before = field[region]
        rounding = 1.17 * fillet_radius  # a quadratic smooth maximum this wide matches a fillet between right angles
        if branch.parent is not None and not branch.open_end and not _continued(branch, tree):
            rounding = max(rounding, _POUCH_ROUNDING)
        elif branch.parent is not None and not tree[branch.parent].open_end:
            rounding *= _BIFURCATION_ROUNDING
        overlap = np.maximum(rounding - np.abs(before - tube), 0.0)
        field[region] = np.maximum(before, tube) + overlap**2 / np.float32(4 * rounding)
        ostia[region] |= overlap > 0
    return field, ostia


def _tube(
    branch: Branch, tree: VesselTree, origin: Array, shape: Array, spacing: float, layers: slice
) -> tuple[tuple[slice, slice, slice], NDArray[np.float32]]:
    """One branch's own distance, on the part of the lattice's layers near it, counted from the first layer."""
    from scipy.spatial import cKDTree

    extend_start, extend_end = branch.parent is None, branch.open_end
    arc, centre, tangent, bend, radius, cosine = _samples(branch, extend_start, extend_end)
    reach = float(branch.radius.max()) - OUTSIDE
    low = np.floor((branch.points.min(axis=0) - reach - origin) / spacing).astype(int) // _CELL * _CELL
    high = np.ceil((branch.points.max(axis=0) + reach - origin) / spacing).astype(int) // _CELL * _CELL + _CELL
    low[0], high[0] = max(low[0], layers.start), min(high[0], layers.stop)  # whole cells: layers are
    if high[0] <= low[0]:
        return (slice(0, 0),) * 3, np.zeros((0, 0, 0), dtype=np.float32)
    cells = (high - low) // _CELL

    # Nearest centreline sample of each block's middle, then Newton's method from there for each lattice point.
    middle = (np.stack(np.meshgrid(*[np.arange(n) for n in cells], indexing="ij"), axis=-1) + 0.5) * _CELL - 0.5
    middle = origin + (low + middle.reshape(-1, 3)) * spacing
    half_diagonal = 0.5 * np.sqrt(3) * _CELL * spacing
    distance, nearest = cKDTree(centre).query(middle, distance_upper_bound=reach + half_diagonal)
    near = np.flatnonzero(np.isfinite(distance))
    near = near[distance[near] - radius[nearest[near]] < -OUTSIDE + half_diagonal]
    corners = np.stack(np.meshgrid(*[np.arange(_CELL)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    inner = (corners - (_CELL - 1) / 2) * spacing
    table = np.concatenate([centre, tangent, bend, radius[:, None], cosine[:, None]], axis=1)
    tube = np.full((len(distance), _CELL**3), 2 * OUTSIDE, dtype=np.float32)
    for some in np.array_split(near, len(near) // _BATCH + 1):
        points = (middle[some][:, None, :] + inner).reshape(-1, 3)
        s, row, offset = _foot(points, np.repeat(arc[nearest[some]], len(inner)), arc, table)
        value = (row[:, 9] - np.sqrt(np.einsum("ij,ij->i", offset, offset))) * row[:, 10]
        if extend_start:
            value = np.minimum(value, s)
        if extend_end:
            value = np.minimum(value, branch.length - s)
        tube[some] = value.reshape(-1, len(inner))

    dense = tube.reshape(*cells, _CELL, _CELL, _CELL).transpose(0, 3, 1, 4, 2, 5).reshape(*(cells * _CELL))
    first, end = np.maximum(low, 0), np.minimum(high, shape)
    region = tuple(slice(a - o, b - o) for a, b, o in zip(first, end, (layers.start, 0, 0), strict=True))
    inside = tuple(slice(a - o, b - o) for a, b, o in zip(first, end, low, strict=True))
    return (region[0], region[1], region[2]), dense[inside]


def _foot(points: Array, s: Array, arc: Array, table: Array) -> tuple[Array, Array, Array]:
    """Newton's method for the nearest centreline place: its arc length, row of the table, and the offset from it."""
    step, last = arc[1] - arc[0], len(arc) - 2
    for iteration in range(_NEWTON_STEPS + 1):
        index = (s - arc[0]) / step
        base = np.clip(index.astype(np.intp), 0, last)
        fraction = (index - base)[:, None]
        row = table[base] * (1 - fraction) + table[base + 1] * fraction
        offset = points - row[:, :3]
        if iteration < _NEWTON_STEPS:
            along = np.einsum("ij,ij->i", offset, row[:, 3:6])
            slope = np.maximum(1.0 - np.einsum("ij,ij->i", offset, row[:, 6:9]), 0.5)
            s = np.clip(s + np.clip(along / slope, -_LONGEST_STEP, _LONGEST_STEP), arc[0], arc[-1])
    return s, row, offset


def _continued(branch: Branch, tree: VesselTree) -> bool:
    """Whether other branches go on from this one."""
    return any(other.parent == branch.name for other in tree)


def _samples(branch: Branch, extend_start: bool, extend_end: bool) -> tuple[NDArray, ...]:
    """Arc, centre, tangent, curvature vector, radius and cosine of the wall's slant at even steps.

    Open ends run on straight beyond their cap.
    """
    from scipy.interpolate import CubicSpline

    count = max(round(branch.length / _SAMPLE), 8)
    step = branch.length / count
    spline = CubicSpline(branch.arc, branch.points)
    before = round(-1.6 * OUTSIDE / step) if extend_start else 0
    after = round(-1.6 * OUTSIDE / step) if extend_end else 0
    index = np.arange(-before, count + after + 1)
    arc = index * step
    inside = np.clip(arc, 0.0, branch.length)
    tangent = spline(inside, 1)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    centre = spline(inside) + (arc - inside)[:, None] * tangent
    bend = np.where(((arc >= 0) & (arc <= branch.length))[:, None], spline(inside, 2), 0.0)
    radius = branch.radius_at(inside)
    cosine = 1 / np.sqrt(1 + np.gradient(radius, step) ** 2)
    return arc, centre, tangent, bend, radius, cosine


def _unit_slope(blocks: NodeBlocks, indices: NDArray[np.int64], spacing: float) -> NodeBlocks:
    """Divides the field by its slope at chosen nodes (n, 3) and clamps it.

    Where tubes were blended it becomes first-order exact, and the wall stays where it is.
    """
    band = _BAND * spacing
    flat, at = blocks.nodes.reshape(-1), blocks.positions(np.clip(indices, 1, np.array(blocks.shape) - 2))
    square = np.zeros(len(indices), dtype=np.float32)
    for stride in STRIDES:
        square += ((flat[at + stride] - flat[at - stride]) / np.float32(2 * spacing)) ** 2
    value = blocks.at(indices)
    near = np.clip(2 - 2 * np.abs(value) / band, 0, 1)  # fades out, so that no step arises at the band's edge
    slope = 1 + near * (np.clip(np.sqrt(square), 0.6, 1.2) - 1)
    own = blocks.own.copy()
    block = blocks.table[tuple((indices >> 3).T)] - 1
    own[(block, *(indices & 7).T)] = value / slope
    return NodeBlocks.from_cores(blocks.stored, np.maximum(own, np.float32(OUTSIDE)), blocks.shape, OUTSIDE)
