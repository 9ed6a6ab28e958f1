"""How well convex hulls stand for a wall: how far they reach into the lumen, where they stay back or leak."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy import Phantom
from cathsim.anatomy.cross_section import plane_coordinates
from cathsim.anatomy.surface import open_ends
from cathsim.contact.hulls import Hull

Array = NDArray[np.float64]

REACH = 15.0e-3  # how far into the lumen hulls are looked for, m
STEP = 0.25e-3  # m
OPENING = 4.0e-3  # so near an open end there is no wall to compare with, m


@dataclass(frozen=True)
class WallFit:
    """Hulls against the true wall, at points of the lumen's surface."""

    # how far hulls reach into the lumen along the normal, m; at most to where another wall is nearer. Shape (n,).
    intrusion: Array
    recess: Array  # how far the first hull lies outside of the lumen, m; infinite where there is none. Shape (n,).
    blocked: NDArray[np.bool_]  # the hulls reach as far as the middle of the lumen. Shape (n,), bool.

    @property
    def leak_share(self) -> float:
        """Share of the wall behind which there is no hull."""
        return float(np.isinf(self.recess).mean())


def wall_fit(phantom: Phantom, hulls: Sequence[Hull], *, samples: int = 4000, seed: int = 0) -> WallFit:
    """Compares hulls with the wall along the normals of points drawn evenly from the lumen's surface.

    Args:
        hulls: m, world frame.
        samples: number of points before those at open ends are left out.
    """
    points, inward = _wall_samples(phantom, samples, seed)
    depths = np.arange(1, round(REACH / STEP) + 1) * STEP
    values = phantom.grid.sample(points[:, None] + depths[:, None] * inward[:, None])
    # along the normal the wall left behind is the nearest one up to the middle of the lumen
    limit = STEP * np.logical_and.accumulate(values > 0.7 * depths, axis=1).sum(1)

    intrusion, nearest = np.zeros(len(points)), np.full(len(points), -np.inf)
    for hull in hulls:
        low, high = hull.vertices.min(0) - REACH, hull.vertices.max(0) + REACH
        near = np.flatnonzero(((points > low) & (points < high)).all(1))
        begin, end = chords(hull, points[near], inward[near])
        crossed = begin <= end
        inside = crossed & (end > 0) & (begin < limit[near])
        reached = near[inside]
        intrusion[reached] = np.maximum(intrusion[reached], np.minimum(end[inside], limit[reached]))
        behind = crossed & (begin < limit[near])
        nearest[near[behind]] = np.maximum(nearest[near[behind]], np.minimum(end[behind], 0.0))
    return WallFit(intrusion, -nearest, (intrusion >= limit) & (limit > 0))


def chords(hull: Hull, points: Array, directions: Array) -> tuple[Array, Array]:
    """Where lines enter and leave a hull.

    Args:
        hull: m, world frame.
        points: on the lines, m. Shape (n, 3).
        directions: unit vectors. Shape (n, 3).

    Returns:
        Coordinates along each line, m, shape (n,) each; a line that misses the hull enters after it leaves.
    """
    normals, offsets = hull.planes()
    slope = directions @ normals.T
    room = offsets - points @ normals.T
    level = np.abs(slope) < 1e-12
    with np.errstate(divide="ignore", invalid="ignore"):
        at = room / slope
    begin = np.where(slope < 0, at, -np.inf)
    end = np.where(slope > 0, at, np.inf)
    beside = level & (room < 0)
    begin[level], end[level] = -np.inf, np.inf
    begin[beside] = np.inf
    return begin.max(1), end.min(1)


def _wall_samples(phantom: Phantom, samples: int, seed: int) -> tuple[Array, Array]:
    """Points of the wall (n, 3) m and their unit normals into the lumen, open ends left out."""
    mesh, generator = phantom.lumen_mesh, np.random.default_rng(seed)
    corners = mesh.triangles[generator.choice(len(mesh.faces), samples, p=mesh.area_faces / mesh.area)]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    points, inward = corners.mean(1), -cross / np.linalg.norm(cross, axis=1, keepdims=True)
    wall = np.ones(samples, bool)
    for centre, normal, radius in open_ends(phantom.tree):
        height, aside = plane_coordinates(points, centre, normal)
        wall &= ~((height > -OPENING) & (height < radius) & (aside < radius + OPENING))
    return points[wall], inward[wall]
