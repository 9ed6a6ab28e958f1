"""An arch whose vessels are known, what is added to it or cut off, and the surface that is drawn of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import trimesh
from numpy.typing import NDArray

from cathsim.anatomy import Phantom
from cathsim.anatomy.vessel_tree import Branch, VesselTree, nearest_on_branch
from cathsim.anatomy.volume.rasterising import rasterise

SPACING = 0.8e-3  # m of the lattice
VOXEL = np.array([0.8e-3, 0.8e-3, 1.5e-3])  # m
REACH = 4e-3  # m of distances, and around what is drawn

Array = NDArray[np.float64]
Field = Callable[[Array], Array]  # (n, 3) m to distances (n,) m, positive inside


@dataclass
class Drawn:
    """An arch, what is added to it or cut off, and what is done to its mesh."""

    phantom: Phantom
    generator: np.random.Generator
    added: list[Field] = field(default_factory=list)
    cuts: list[Field] = field(default_factory=list)
    apart: list[Field] = field(default_factory=list)  # surfaces of their own
    low: list[Array] = field(default_factory=list)  # points that must lie within the lattice
    opened: list[tuple[Array, Array, float]] = field(default_factory=list)  # centre, normal outward, radius
    wall: float = 0.0  # m
    voxels: bool = False
    pieces: bool = False
    segments: bool = False
    mesh: list[Callable[[trimesh.Trimesh], trimesh.Trimesh]] = field(default_factory=list)
    shift: Array = field(default_factory=lambda: np.zeros(3))  # m
    unit: float = 1e-3  # m

    @property
    def tree(self) -> VesselTree:
        return self.phantom.tree

    def inside(self, points: Array) -> Array:
        """Distances of the lumen as it is drawn."""
        values = self.phantom.grid.sample(points)
        for one in self.added:
            values = np.maximum(values, one(points))
        for one in self.cuts:
            values = np.minimum(values, one(points))
        return values

    def limb(self, share: float) -> tuple[Array, Array, float]:
        """Place, direction downstream and radius at a share of the aorta from the heart on."""
        aorta = self.tree.root
        arc = self.from_heart(share * aorta.length)
        return aorta.point_at(arc), -aorta.tangent_at(arc), float(aorta.radius_at(arc))

    def from_heart(self, arc: float) -> float:
        """Arc length on the aorta's centreline, which begins at its lower end, of one from the heart on, m."""
        return self.tree.root.length - arc

    def ostia(self) -> list[float]:
        """Arc lengths of the arch's ostia from the heart on, m."""
        children = [b for b in self.tree if b.parent == self.tree.root.name and b.name != "sac"]
        return sorted(self.from_heart(b.parent_arc) for b in children)


def tube(points: Array, radius: float) -> Field:
    """A tube along points (n, 3) m."""
    course = Branch("tube", points, np.full(len(points), radius))
    return lambda places: radius - nearest_on_branch(course, places)[2]


def ball(centre: Array, radius: float) -> Field:
    return lambda places: radius - np.linalg.norm(places - centre, axis=1)


def line(start: Array, *steps: Array) -> Array:
    """Points of a polyline from start by steps, a millimetre apart."""
    corners = np.cumsum(np.array([start, *steps]), axis=0)
    parts = [np.linspace(a, b, max(int(np.linalg.norm(b - a) / 1e-3), 2))[:-1] for a, b in pairwise(corners)]
    return np.concatenate([*parts, corners[-1:]])


def add(drawn: Drawn, points: Array, radius: float) -> None:
    drawn.added.append(tube(points, radius))
    drawn.low.append(points)


def cut_vessel(drawn: Drawn, branch: Branch, arc: float, beyond: bool) -> None:
    """Removes what lies beyond a cross section of one vessel (or before it)."""
    centre, normal = branch.point_at(arc), branch.tangent_at(arc) * (1.0 if beyond else -1.0)

    def kept(places: Array) -> Array:
        _, along, away = nearest_on_branch(branch, places)
        mine = (away < 1.8 * branch.radius_at(along) + REACH) & (
            (along > arc - 5e-3) if beyond else (along < arc + 5e-3)
        )
        for other in drawn.tree:
            if other.name not in (branch.name, branch.parent, "sac") and other.parent != branch.parent != "aorta":
                _, at, aside = nearest_on_branch(other, places)
                mine &= aside > 1.3 * other.radius_at(at)
        return np.where(mine, (centre - places) @ normal, np.inf)

    drawn.cuts.append(kept)


def _surface(function: Field, low: Array, high: Array, spacing: Array, binary: bool = False) -> trimesh.Trimesh:
    """Marching cubes of a field between two corners, m."""
    from skimage.measure import marching_cubes

    shape = np.ceil((high - low) / spacing).astype(int) + 1
    values = np.empty(int(shape.prod()))
    places = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), axis=-1).reshape(-1, 3)
    for some in np.array_split(np.arange(len(places)), len(places) // 400_000 + 1):
        values[some] = function(low + places[some] * spacing)
    values = np.clip(values, -REACH, REACH).reshape(shape)
    if binary:
        values = (values > 0) - 0.5
    values = np.pad(values, 1, constant_values=-REACH if not binary else -0.5)
    vertices, faces, _, _ = marching_cubes(values, 0.0, spacing=tuple(spacing), allow_degenerate=False)
    return trimesh.Trimesh(vertices + low - spacing, faces[:, ::-1], process=False)


def _segments(phantom: Phantom) -> list[trimesh.Trimesh]:
    """The surface of every vessel's voxels, smoothed a little."""
    from scipy.ndimage import gaussian_filter
    from skimage.measure import marching_cubes

    numbers = {name: number for number, name in enumerate(phantom.tree.names, 1)}
    labels, affine = rasterise(phantom, tuple(VOXEL), None, numbers)
    made = []
    for number in numbers.values():
        soft = gaussian_filter(np.pad((labels == number).astype(np.float32), 2), 0.8)
        vertices, faces, _, _ = marching_cubes(soft, 0.5, allow_degenerate=False)
        places = (vertices - 2) @ affine[:3, :3].T + affine[:3, 3]
        made.append(trimesh.Trimesh(1e-3 * places * [-1.0, -1.0, 1.0], faces, process=False))
    return made


def draw(drawn: Drawn) -> trimesh.Trimesh:
    """The surface, in the file's unit."""
    low, high = drawn.phantom.bounds
    points = np.concatenate([np.array([low, high]), *drawn.low])
    low, high = points.min(axis=0) - 3 * REACH, points.max(axis=0) + 3 * REACH
    fine = np.full(3, min(SPACING, float(min(b.radius.min() for b in drawn.tree)) / 3))

    def solid(places: Array) -> Array:
        values = drawn.inside(places)
        if drawn.wall:
            values = np.minimum(values + drawn.wall, -values)
            for centre, normal, radius in drawn.opened:
                height = (places - centre) @ normal
                aside = np.linalg.norm(places - centre - height[:, None] * normal, axis=1)
                mine = (aside < 1.5 * radius + 3e-3) & (np.abs(height) < 1.5 * radius)
                values = np.where(mine, np.minimum(values, -height), values)
        return values

    if drawn.pieces:
        made = []
        for branch in drawn.tree:

            def piece(places: Array, branch: Branch = branch) -> Array:
                _, along, away = nearest_on_branch(branch, places)
                return np.minimum(drawn.inside(places), 1.2 * branch.radius_at(along) + 1e-3 - away)

            made.append(_surface(piece, low - drawn.generator.uniform(0, fine[0], 3), high, fine))
        mesh = trimesh.util.concatenate(made)
    elif drawn.segments:
        mesh = trimesh.util.concatenate(_segments(drawn.phantom))
    else:
        mesh = _surface(solid, low, high, VOXEL if drawn.voxels else fine, drawn.voxels)
    if drawn.opened and not drawn.wall:
        for centre, normal, radius in drawn.opened:
            middle = mesh.triangles_center - centre
            height = middle @ normal
            aside = np.linalg.norm(middle - height[:, None] * normal, axis=1)
            mesh = trimesh.Trimesh(
                mesh.vertices,
                mesh.faces[(height < 0) | (height > radius + 3e-3) | (aside > 1.5 * radius + 2e-3)],
                process=False,
            )
    for change in drawn.mesh:
        mesh = change(mesh)
    for one in drawn.apart:
        mesh = trimesh.util.concatenate([mesh, _surface(one, low, high, fine)])
    return trimesh.Trimesh((mesh.vertices + drawn.shift) / drawn.unit, mesh.faces, process=False)
