"""Openings of a surface: single missing triangles are put back, every other border is closed by a cone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.reading import Indices, Triangles
from cathsim.anatomy.mesh.report import MeshRefusedError

_MOST_BORDER = 0.4  # of all edges may belong to one triangle only: a coarse open tube has fewer
_MOST_PAIRS = 20_000_000  # of border edges at one vertex that are looked at for missing triangles

Array = NDArray[np.float64]


def close_openings(mesh: Triangles) -> tuple[Triangles, Array, int]:
    """Closes every border of a welded surface.

    Three border edges in a ring stand for a missing triangle. All other border edges are taken apart into rings, and
    each is closed by a cone from its edges to its middle.

    Returns:
        The triangles with those added; the middles (k, 3) of the rings closed by cones; the number of triangles put
        back.

    Raises:
        MeshRefusedError: the surface is full of holes.
    """
    border, edges = _border(mesh)
    missing = _missing_triangles(mesh, border)
    if len(missing):
        mesh = Triangles(mesh.vertices, np.concatenate([mesh.faces, missing]))
        border, edges = _border(mesh)
    if len(border) > _MOST_BORDER * edges:
        raise MeshRefusedError(
            f"the surface is full of holes: {len(border) / edges:.0%} of its edges belong to one triangle only; "
            "fill them, or export the mesh again with all its triangles."
        )
    if len(border) == 0:
        return mesh, np.empty((0, 3)), len(missing)
    ring = _rings(border)
    middle = mesh.vertices[border].mean(axis=1)
    weight = np.bincount(ring)
    apex = np.stack([np.bincount(ring, middle[:, k]) / weight for k in range(3)], axis=1)
    cones = np.column_stack([border, len(mesh.vertices) + ring])
    closed = Triangles(np.concatenate([mesh.vertices, apex]), np.concatenate([mesh.faces, cones]))
    return closed, apex, len(missing)


def _border(mesh: Triangles) -> tuple[Indices, int]:
    """Edges (n, 2) that belong to one triangle, the lower vertex first, and how many edges there are in all."""
    pairs = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    key, count = np.unique(pairs[:, 0] * len(mesh.vertices) + pairs[:, 1], return_counts=True)
    return np.stack(np.divmod(key[count == 1], len(mesh.vertices)), axis=1), len(key)


def _missing_triangles(mesh: Triangles, border: Indices) -> Indices:
    """Triangles (n, 3) whose three edges are border edges and that the mesh does not have; each edge is used once."""
    size = len(mesh.vertices)
    degree = np.bincount(border[:, 0], minlength=size)  # edges that lead to a higher vertex
    if len(border) == 0 or np.sum(degree.astype(float)[border[:, 1]]) > _MOST_PAIRS:
        return np.empty((0, 3), np.int64)
    # border is in order of its first vertex: every edge a-b is continued by all edges b-c
    first = np.concatenate([[0], np.cumsum(degree)])
    many = degree[border[:, 1]]
    edge = np.repeat(np.arange(len(border)), many)
    within = np.arange(len(edge)) - np.repeat(np.cumsum(many) - many, many)
    third = border[first[border[edge, 1]] + within, 1]
    a, b = border[edge].T
    keys = border[:, 0] * size + border[:, 1]  # in order
    place = np.minimum(np.searchsorted(keys, a * size + third), len(keys) - 1)
    ring = keys[place] == a * size + third
    candidates = np.stack([a, b, third], axis=1)[ring]
    corners = np.sort(mesh.faces, axis=1)
    known = set(map(tuple, corners[np.isin(corners[:, 0], candidates[:, 0])].tolist()))
    used: set[tuple[int, int]] = set()
    triangles = []
    for a, b, c in candidates.tolist():
        own = {(a, b), (b, c), (a, c)}
        if (a, b, c) not in known and not own & used:
            used |= own
            triangles.append((a, b, c))
    return np.array(triangles, np.int64).reshape(-1, 3)


def _rings(border: Indices) -> Indices:
    """The ring (n,) that every border edge belongs to; where rings touch they are taken apart at their vertices."""
    ends = border.tolist()
    at: dict[int, list[int]] = {}
    for number, (a, b) in enumerate(ends):
        at.setdefault(a, []).append(number)
        at.setdefault(b, []).append(number)
    ring = np.full(len(border), -1)
    count = 0
    start = 0
    while start < len(border):
        if ring[start] >= 0:
            start += 1
            continue
        vertices, walk = [ends[start][0]], []
        place = {vertices[0]: 0}
        taken: set[int] = set()
        while True:
            onward = at[vertices[-1]]
            while onward and (ring[onward[-1]] >= 0 or onward[-1] in taken):
                onward.pop()
            if not onward:  # at its start again, or where edges of three triangles leave an open line
                break
            edge = onward.pop()
            taken.add(edge)
            walk.append(edge)
            a, b = ends[edge]
            far = b if vertices[-1] == a else a
            if far not in place:
                place[far] = len(vertices)
                vertices.append(far)
                continue
            first = place[far]
            ring[walk[first:]] = count
            count += 1
            for passed in vertices[first + 1 :]:
                del place[passed]
            del vertices[first + 1 :], walk[first:]
        if walk:
            ring[walk] = count
            count += 1
    return ring
