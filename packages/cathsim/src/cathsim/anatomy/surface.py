"""Surfaces of a phantom: the watertight lumen and the wall around it, cut open at the vessel ends."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.distance_grid import SignedDistanceGrid, plane_coordinates
from cathsim.anatomy.vessel_tree import VesselTree

if TYPE_CHECKING:
    import trimesh

_DENSE = 2**24  # nodes: the surface of a larger lattice is made slab by slab
_SLAB = 16  # cells along x
MAXIMUM_WALL = 5e-3  # m: beyond it the distance grid's padding ends

Array = NDArray[np.float64]


def lumen_surface(grid: SignedDistanceGrid, *, level: float = 0.0) -> trimesh.Trimesh:
    """Watertight surface by marching cubes, m, world frame, normals out of the lumen.

    Args:
        level: distance from the wall, m, positive inside the lumen; 0 is the wall itself.
    """
    import trimesh
    from skimage.measure import marching_cubes

    if math.prod(grid.shape) > _DENSE:
        vertices, faces = _surface_in_slabs(grid, level)
    else:
        vertices, faces, _, _ = marching_cubes(
            grid.dense(), level=level, spacing=(grid.spacing,) * 3, allow_degenerate=False
        )
    a, b, c = (vertices[faces[:, k]].astype(np.float64) for k in range(3))
    if np.einsum("ij,ij->", a, np.cross(b, c)) < 0:  # six times the volume
        faces = np.ascontiguousarray(faces[:, ::-1])
    return trimesh.Trimesh(vertices + grid.origin, faces, process=False)


def _surface_in_slabs(grid: SignedDistanceGrid, level: float) -> tuple[Array, NDArray[np.int64]]:
    """Marching cubes slab by slab along x: vertices (n, 3) m from the grid's origin, and faces (m, 3)."""
    from skimage.measure import marching_cubes

    inside = grid.blocks.where(lambda values: values > level)[0]
    low = np.maximum(inside.min(axis=0) - 1, 0).tolist()
    high = np.minimum(inside.max(axis=0) + 2, grid.shape).tolist()
    pieces, triangles, count = [], [], 0
    for first in range(low[0], high[0] - 1, _SLAB):
        # neighbouring slabs share a layer of nodes, on which they make the same vertices
        slab = grid.dense(
            (slice(first, min(first + _SLAB + 1, high[0])), slice(low[1], high[1]), slice(low[2], high[2]))
        )
        if slab.min() < level < slab.max():
            vertices, faces, _, _ = marching_cubes(slab, level=level, allow_degenerate=False)
            pieces.append(vertices.astype(np.float64) + np.array([first, low[1], low[2]]))
            triangles.append(faces.astype(np.int64) + count)
            count += len(vertices)
    vertices, faces = np.concatenate(pieces), np.concatenate(triangles)
    shared = np.flatnonzero((vertices[:, 0] - low[0]) % _SLAB == 0)
    _, first_of, same_as = np.unique(vertices[shared], axis=0, return_index=True, return_inverse=True)
    numbers = np.arange(count)
    numbers[shared] = shared[first_of][same_as.reshape(-1)]
    used, renumbered = np.unique(numbers, return_inverse=True)
    return vertices[used] * grid.spacing, renumbered.reshape(-1)[faces]


def open_ends(tree: VesselTree) -> list[tuple[Array, Array, float]]:
    """Flat openings of a vessel tree: centre (3,) m, unit normal (3,) out of the vessel, and radius m each."""
    root = tree.root
    ends = [(root.points[0], -root.tangents[0], float(root.radius[0]))]
    ends += [(b.points[-1], b.tangents[-1], float(b.radius[-1])) for b in tree if b.open_end]
    return ends


def wall_surface(grid: SignedDistanceGrid, tree: VesselTree, thickness: float) -> trimesh.Trimesh:
    """The vessel wall as a solid of even thickness (m), cut open at the ends; m, world frame.

    Of a grid of more than 2^24 nodes it is made from every second node.

    Raises:
        ValueError: the thickness is not positive, or larger than the grid's padding.
    """
    if not 0 < thickness <= MAXIMUM_WALL:
        raise ValueError(f"wall thickness must lie in (0, {MAXIMUM_WALL:g}] m, got {thickness!r}.")
    while math.prod(grid.shape) > _DENSE:
        grid = grid.coarser(2)
    outer = lumen_surface(grid, level=-thickness)
    inner = lumen_surface(grid)
    # Cut a little inside the caps, where both surfaces still run along the vessel.
    planes = [(c - 1.5 * grid.spacing * n, n, r + thickness + 4e-3) for c, n, r in open_ends(tree)]
    for centre, normal, radius in planes:
        outer = _cut(outer, centre, normal, radius)
        inner = _cut(inner, centre, normal, radius)
    inner.invert()
    borders = _border(inner), _border(outer)
    rims = [_rim(*borders, centre, normal, radius) for centre, normal, radius in planes]
    return _weld([outer, inner, *rims])


def _cut(mesh: trimesh.Trimesh, centre: Array, normal: Array, radius: float) -> trimesh.Trimesh:
    """Removes what lies beyond a plane, near its centre only."""
    import trimesh

    height, aside = plane_coordinates(mesh.vertices, centre, normal)
    local = (aside < radius) & (np.abs(height) < radius)
    near = local[mesh.faces].all(axis=1)
    vertices, faces, _ = trimesh.intersections.slice_faces_plane(mesh.vertices, mesh.faces[near], -normal, centre)
    piece = trimesh.Trimesh(vertices, faces, process=False)
    rest = trimesh.Trimesh(mesh.vertices, mesh.faces[~near], process=False)
    return _weld([rest, piece])


def _weld(pieces: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    """One mesh of several, equal vertices merged and faces that thereby shrank to a line removed."""
    import trimesh

    joined: trimesh.Trimesh = trimesh.util.concatenate(pieces)  # type: ignore[assignment]
    joined.merge_vertices(digits_vertex=8)
    a, b, c = joined.faces.T
    joined.update_faces((a != b) & (b != c) & (c != a))
    joined.remove_unreferenced_vertices()
    return joined


def _border(mesh: trimesh.Trimesh) -> Array:
    """Vertices (n, 3) of the edges that belong to one face alone."""
    import trimesh

    alone = trimesh.grouping.group_rows(mesh.edges_sorted, require_count=1)
    return mesh.vertices[np.unique(mesh.edges_sorted[alone])]


def _rim(inner: Array, outer: Array, centre: Array, normal: Array, radius: float) -> trimesh.Trimesh:
    """Flat ring between the cut edges (n, 3) of the two surfaces, zipped up in order of angle."""
    import trimesh

    first = np.cross(normal, [0.3, 0.5, 0.8])
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)

    def loop(border: Array) -> tuple[Array, Array]:
        offset = border - centre
        rim_mask = (np.abs(offset @ normal) < 1e-6) & (np.linalg.norm(offset, axis=1) < radius + 2e-3)
        border, offset = border[rim_mask], offset[rim_mask]
        angle = np.arctan2(offset @ second, offset @ first)
        order = np.argsort(angle)
        return border[order], angle[order]

    inside, inside_angle = loop(inner)
    outside, outside_angle = loop(outer)
    n, m = len(inside), len(outside)
    if n < 3 or m < 3:
        return trimesh.Trimesh()
    faces = []
    i = j = 0
    while i < n or j < m:
        next_inside = inside_angle[i + 1] if i + 1 < n else inside_angle[0] + 2 * np.pi
        next_outside = outside_angle[j + 1] if j + 1 < m else outside_angle[0] + 2 * np.pi
        if j >= m or (i < n and next_inside <= next_outside):
            faces.append((i % n, n + j % m, (i + 1) % n))
            i += 1
        else:
            faces.append((i % n, n + j % m, n + (j + 1) % m))
            j += 1
    return trimesh.Trimesh(np.concatenate([inside, outside]), faces, process=False)
