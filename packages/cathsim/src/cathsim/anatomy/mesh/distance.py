"""Signed distance to the part of a surface that bounds the lumen, exact at the wall, flat at the vessels' ends."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.centreline import arc_length, resampled
from cathsim.anatomy.distance_grid import SignedDistanceGrid, across_frames, in_cylinder
from cathsim.anatomy.lumen import OUTSIDE, PADDING
from cathsim.anatomy.mesh.cavity import Cavity, largest_part
from cathsim.anatomy.mesh.ends import VesselEnd
from cathsim.anatomy.mesh.lattice import dilated, short_distance
from cathsim.anatomy.mesh.samples import SurfaceSamples, sample_surface
from cathsim.lattice.node_set import linked_parts
from cathsim.presets import WIRE_RADIUS

EXACT = 3e-3  # m from the wall within which distances are to triangles, not to points on them
_SWEPT = 1.8  # radii before a flat end over which the lumen is filled across the vessel
_OWN = 1.15  # radii from the middle of an end: what goes on beyond it from further aside is another vessel
_CLEARLY = 0.8  # voxels by which a triangle's two sides must differ in their distance to the lumen
_LOOSE = 1.8  # voxels: nearer to a triangle than this a point is in or out as that triangle says
_SEEN = 4  # voxels from the lumen up to which distances are told apart
_THIN = 7e-4  # m between the points on the surface to which far distances are measured
_SHUT = 0.95  # of a wire's radius: distance to the wall in cavities that no wire gets into
_AROUND = 10  # voxels around places whose slope is taken: more than the smoothing reaches
_FACING = 2.0  # voxels between the lumen's voxels and the triangles that bound it, at most

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def trim_cavity(cavity: Cavity, ends: Sequence[VesselEnd]) -> Mask:
    """The lumen's voxels (nx, ny, nz) up to its flat ends: a tunnel is filled up to them, the rest is dropped."""
    from scipy.ndimage import binary_closing, generate_binary_structure, label

    free = ~cavity.wall
    # Openings in a wall's side are bridged, so that the lumen has no dents before them.
    inside = binary_closing(cavity.inside, generate_binary_structure(3, 1), iterations=4) & free | cavity.inside
    for end in ends:
        swept = cavity.index(_swept(end, cavity))
        inside[tuple(swept.T)] = True
        reach = 2.0 * end.radius + 4 * cavity.spacing
        low, high = cavity.index(end.centre - reach), cavity.index(end.centre + reach)
        box = tuple(slice(a, b + 1) for a, b in zip(low, high, strict=True))
        axes = [cavity.origin[k] + np.arange(low[k], high[k] + 1) * cavity.spacing - end.centre[k] for k in range(3)]
        offset = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        height = offset @ end.normal
        aside = np.linalg.norm(offset - height[..., None] * end.normal, axis=-1)
        part = inside[box]
        before = (height <= 0) & (height > -_SWEPT * end.radius) & (aside < 1.3 * end.radius)
        part |= binary_closing(part & before) & before & free[box]
        beyond, _ = label(part & (height > 0) & (height < 1.5 * end.radius) & (aside < 1.6 * end.radius))
        at_end = (height < 2 * cavity.spacing) & (aside < _OWN * end.radius + cavity.spacing)
        part &= (beyond == 0) | ~np.isin(beyond, beyond[at_end])
    return largest_part(inside & free)


def _swept(end: VesselEnd, cavity: Cavity) -> Array:
    """Points (n, 3) m that a vessel's middle sees across the vessel, over its last stretch.

    Where a ray meets no wall, as in a gap, it ends where its neighbours do.
    """
    back = arc_length(end.way[::-1])[::-1]
    middles = resampled(end.way[back <= _SWEPT * end.radius], 0.5 * cavity.spacing)
    count = int(np.clip(3 * np.pi * end.radius / cavity.spacing, 32, 400))
    first, second = (v[0] for v in across_frames(end.normal[None]))
    angles = np.arange(count) * 2 * np.pi / count
    rays = np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * second
    travel = np.arange(0.0, 1.2 * end.radius, 0.7 * cavity.spacing)
    points = []
    for middle in middles:
        line = middle + travel[None, :, None] * rays[:, None, :]
        struck = cavity.holds(cavity.wall, line)
        reach = np.where(struck.any(axis=1), np.argmax(struck, axis=1), 0)
        if not reach.any():
            continue
        reach = np.where(reach > 0, reach, int(np.median(reach[reach > 0])))
        points.append(line[np.arange(len(travel)) < reach[:, None]])
    return np.concatenate(points) if points else middles


def lumen_samples(
    samples: SurfaceSamples, cavity: Cavity, inside: Mask, ends: Sequence[VesselEnd], away: NDArray[np.float32]
) -> SurfaceSamples:
    """The part of a surface that bounds the lumen, with patches over its gaps.

    Args:
        samples: points on the whole surface.
        inside: (nx, ny, nz) voxels of the lumen.
        away: what `voxels_away` says of them.

    Returns:
        Samples of triangles whose normals point into the lumen.
    """
    near = samples.select(cavity.holds(away <= _FACING, samples.points))
    normals = near.normals[near.face]
    step = 1.2 * cavity.spacing
    ahead, behind = (_look(away, cavity, near.points + s * step * normals) for s in (1, -1))
    # Each triangle turns as most of its points say, weighted by how clearly they do.
    says = np.bincount(near.face, behind - ahead, minlength=len(near.corners))
    corners = near.corners.copy()
    corners[says < 0] = corners[says < 0][:, ::-1]
    # Triangles that stand across the wall, as the rim of a thick one does, bound nothing.
    facing = np.abs(says) >= _CLEARLY * np.maximum(np.bincount(near.face, minlength=len(corners)), 1)
    seen = np.zeros(len(corners), dtype=bool)
    seen[near.face] = True
    faces = corners[seen & facing]

    covered = cavity.wall | inside
    gaps = np.argwhere(inside & dilated(~covered))
    gap_points = cavity.origin + gaps * cavity.spacing
    for end in ends:
        beside = np.linalg.norm(gap_points - end.centre, axis=1) < 1.6 * end.radius
        gap_points = gap_points[~(beside & ((gap_points - end.centre) @ end.normal > -2.5 * cavity.spacing))]
    pieces = [faces]
    if len(gap_points):
        pieces.append(_patches(gap_points, cavity, away, inside))
    whole = sample_surface(np.concatenate(pieces), 0.7 * cavity.spacing)
    return whole.select(cavity.holds(away <= _FACING + 1, whole.points))


def voxels_away(inside: Mask) -> NDArray[np.float32]:
    """Distance (nx, ny, nz) in voxels to the lumen's voxels, up to a few; beyond, more than those."""
    distance: NDArray[np.float32] = np.sqrt(short_distance(inside, _SEEN).astype(np.float32))
    return np.minimum(distance, _SEEN + 1, out=distance)


def _look(away: NDArray[np.float32], cavity: Cavity, points: Array) -> Array:
    i, j, k = cavity.index(points).T
    return away[i, j, k].astype(np.float64)


def _patches(points: Array, cavity: Cavity, away: NDArray[np.float32], inside: Mask) -> Array:
    """Small triangles (n, 3, 3) m where the lumen borders on free space, normals into the lumen."""
    from scipy.ndimage import gaussian_filter

    index = cavity.index(points)
    low = np.maximum(index.min(axis=0) - _AROUND, 0)
    box = tuple(slice(a, b + _AROUND + 1) for a, b in zip(low, index.max(axis=0), strict=True))
    smooth = gaussian_filter(inside[box].astype(np.float32), 2.0)
    i, j, k = (index - low).T
    slopes = (
        smooth[i + 1, j, k] - smooth[i - 1, j, k],
        smooth[i, j + 1, k] - smooth[i, j - 1, k],
        smooth[i, j, k + 1] - smooth[i, j, k - 1],
    )
    normal = np.stack(slopes, axis=1) / 2
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal), axis=1)])
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-9)
    second = np.cross(normal, first)
    size = 0.8 * cavity.spacing
    points = points - 0.5 * cavity.spacing * normal
    return np.stack(
        [
            points + size * first,
            points + size * (0.87 * second - 0.5 * first),
            points - size * (0.87 * second + 0.5 * first),
        ],
        axis=1,
    )


def distance_grid(
    surface: SurfaceSamples,
    cavity: Cavity,
    inside: Mask,
    ends: Sequence[VesselEnd],
    away: NDArray[np.float32],
    *,
    rotation: Array,
    offset: Array,
    resolution: float,
    reach: float = -OUTSIDE,
    exact_within: float = EXACT,
    deep: bool = True,
) -> SignedDistanceGrid:
    """Signed distance grid of a lumen, in a turned frame: positive inside, clamped far outside, with padding.

    Args:
        surface: bounds the lumen, normals into it.
        cavity: the lumen's lattice, in the frame of the surface.
        inside: (nx, ny, nz) its voxels.
        away: what `voxels_away` says of them.
        rotation: (3, 3) from the surface's frame to the grid's.
        offset: (3,) m, added after the rotation.
        resolution: m between the grid's points.
        reach: m outside the lumen up to which distances are measured.
        exact_within: m from the wall within which distances are to triangles, not to points on them.
        deep: whether distances far inside are measured; otherwise they are the reach from there on.
    """
    lumen = (cavity.origin + np.argwhere(inside) * cavity.spacing) @ rotation.T + offset
    low, high = lumen.min(axis=0) - cavity.spacing, lumen.max(axis=0) + cavity.spacing
    origin = np.floor(low / resolution - PADDING) * resolution
    shape = np.ceil((high - origin) / resolution).astype(int) + PADDING + 1
    indices = _near_nodes(lumen, origin, shape, resolution, reach)
    points = (origin + indices * resolution - offset) @ rotation
    # A voxel next to the lumen and far from what bounds it belongs to a loose sheet in it, which is no wall.
    sign = np.where(cavity.holds(away <= _LOOSE, points), 1.0, -1.0)
    farthest = max(reach, exact_within + _THIN)
    distance = _far_distance(surface.points, points, farthest, (sign > 0) & deep)
    close = np.flatnonzero(distance < exact_within + _THIN)
    exact, place, face = surface.nearest(points[close])
    distance[close] = exact
    side = np.einsum("ij,ij->i", points[close] - place, surface.normals[face])
    # Within the wall's own voxels only the triangle itself decides the side.
    unsure = (exact < _LOOSE * cavity.spacing) & cavity.holds(away <= _FACING + 1, points[close])
    sign[close[unsure]] = np.where(side[unsure] >= 0, 1.0, -1.0)
    distance *= sign
    for end in ends:
        heights = -1.5 * end.radius, 1.5 * end.radius
        beside, height = in_cylinder(points, end.centre, end.normal, heights, 1.4 * end.radius)
        distance[beside] = np.minimum(distance[beside], -height)
    # Where flat ends meet the wall single points may come out on the wrong side: only what hangs together is lumen.
    positive = np.flatnonzero(distance > 0)
    loose = positive[~_largest_component(indices[positive], shape)]
    distance[loose] *= -1
    # A cavity beyond a passage that no wire passes is closed to wires as well.
    open_ = np.flatnonzero(distance > WIRE_RADIUS)
    shut = open_[~_largest_component(indices[open_], shape)]
    distance[shut] = _SHUT * WIRE_RADIUS
    near = distance > -reach
    nx, ny, nz = (int(n) for n in shape)
    return SignedDistanceGrid.from_nodes(
        indices[near], distance[near], (nx, ny, nz), origin, resolution, outside=-reach
    )


def _far_distance(surface: Array, points: Array, farthest: float, unbounded: Mask) -> Array:
    """Distance (n,) m from points (n, 3) to a thinned surface's (m, 3); beyond `farthest` that, where it is bounded."""
    from scipy.spatial import cKDTree

    cells = np.floor(surface / _THIN).astype(np.int64)
    cells -= cells.min(axis=0)
    _, ny, nz = (int(n) for n in cells.max(axis=0) + 1)
    _, first = np.unique((cells[:, 0] * ny + cells[:, 1]) * nz + cells[:, 2], return_index=True)
    tree = cKDTree(surface[first], leafsize=48, balanced_tree=False, compact_nodes=False)  # twice as fast
    distance = np.empty(len(points))
    distance[unbounded] = tree.query(points[unbounded])[0]
    distance[~unbounded] = tree.query(points[~unbounded], distance_upper_bound=farthest)[0]
    return np.minimum(distance, farthest, out=distance, where=~unbounded)


def _largest_component(nodes: NDArray[np.int64], shape: NDArray[np.int64]) -> Mask:
    """Which of some lattice points (n, 3), in C order, belong to the largest part that hangs together by faces."""
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    keys = nodes @ strides
    order = np.argsort(keys)
    keys = keys[order]
    first, second = [], []
    for stride in strides:  # the lattice has a border of other nodes, so that no neighbour is beyond it
        place = np.minimum(np.searchsorted(keys, keys + stride), len(keys) - 1)
        pair_starts = np.flatnonzero(keys[place] == keys + stride)
        first.append(pair_starts)
        second.append(place[pair_starts])
    labels = linked_parts(np.concatenate(first), np.concatenate(second), len(keys))
    mask = np.zeros(len(nodes), dtype=bool)
    if len(labels):
        mask[order] = labels == np.argmax(np.bincount(labels))
    return mask


def _near_nodes(
    lumen: Array, origin: Array, shape: NDArray[np.int64], resolution: float, reach: float
) -> NDArray[np.int64]:
    """Lattice points (n, 3) within reach (m) of the lumen's voxels (m, 3) m, found on a coarse lattice."""
    from scipy.ndimage import distance_transform_edt

    step = max(round(2e-3 / resolution), 1)
    rough = np.zeros(-(-shape // step), dtype=bool)
    rough[tuple(np.floor((lumen - origin) / (step * resolution)).astype(int).T)] = True
    near = distance_transform_edt(~rough) * step * resolution < reach + step * resolution
    cells = np.argwhere(near) * step
    within = np.stack(np.meshgrid(*[np.arange(step)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    nodes: NDArray[np.int64] = (cells[:, None] + within).reshape(-1, 3)
    return nodes[(nodes < shape).all(axis=1)]
