"""A surface file as clean triangles (read, welded, thinned out where it is too fine), and its unit of length."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.budget import Budget
from cathsim.anatomy.mesh.cavity import find_cavity
from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.mesh.samples import sample_surface

SUFFIXES = (".stl", ".obj", ".ply")
MOST_BYTES = 2_000_000_000  # about forty million faces of a binary STL
MOST_FACES = 400_000  # above this a mesh is thinned out
_STRAY, _MOST_STRAY = 0.5, 10.0  # % of vertices at either side, and how many times further than the others they may lie
_WELD = 1e-5  # of the largest extent: vertices nearer than this are one
_CLUSTERS = 500  # cells along the largest extent when a mesh is thinned out

UNITS: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}
_WIDTH, _EXTENT = 0.028, 0.22  # m: an aorta's widest place, and an arch's largest extent
_EXTENT_WEIGHT = 0.25  # extents differ more: some models reach down to the groin
_WORST = 1.1  # score beyond which no unit makes an aorta of the surface
_CLOSE = 0.35  # scores nearer to each other than this leave a choice
_VOXELS = 130  # along the largest extent

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Triangles:
    """Triangles without any order or orientation that could be relied on."""

    vertices: Array  # (n, 3), in the file's unit until scaled
    faces: Indices  # (m, 3) indices of vertices

    @property
    def corners(self) -> Array:
        """Corners (m, 3, 3) of every face."""
        return self.vertices[self.faces]

    @property
    def bounds(self) -> Array:
        """Lowest and highest corner (2, 3) of the vertices that faces use."""
        used = self.vertices[np.unique(self.faces)]
        return np.stack([used.min(axis=0), used.max(axis=0)])

    @property
    def extent(self) -> float:
        """Longest side of the bounding box."""
        return float(np.ptp(self.bounds, axis=0).max())

    def scaled(self, factor: float) -> Triangles:
        """The same triangles in another unit, by the factor of an old unit in new ones."""
        return Triangles(self.vertices * factor, self.faces)


def is_mesh_path(name: str) -> bool:
    """Whether a phantom's name is a path to a mesh: it ends like one."""
    return name.lower().endswith(SUFFIXES)


def read_triangles(path: Path) -> Triangles:
    """Reads the triangles of an STL, OBJ or PLY file, as they are, in the file's unit.

    Raises:
        MeshRefusedError: for a file that is missing, empty, too large or no such mesh.
    """
    import trimesh

    if not path.is_file():
        raise MeshRefusedError(f"there is no file {path}; give the path of an STL, OBJ or PLY file.")
    if path.suffix.lower() not in SUFFIXES:
        raise MeshRefusedError(f"{path.name} is none of {', '.join(SUFFIXES)}; convert it to one of them.")
    size = path.stat().st_size
    if size == 0:
        raise MeshRefusedError(f"{path.name} is empty; export the mesh again.")
    if size > MOST_BYTES:
        raise MeshRefusedError(
            f"{path.name} has {size / 1e9:.1f} GB, at most {MOST_BYTES / 1e9:.0f} GB are read; simplify it first."
        )
    expected = f"expected a triangle mesh in {path.suffix[1:].upper()} format; export it again"
    try:
        loaded = trimesh.load(path, force="mesh", process=False)
    except Exception as error:
        # The readers of three formats raise what they like on damaged files.
        raise MeshRefusedError(f"{path.name} cannot be read as a mesh: {expected}.") from error
    vertices = np.asarray(getattr(loaded, "vertices", np.zeros((0, 3))), dtype=np.float64)
    faces = np.asarray(getattr(loaded, "faces", np.zeros((0, 3))), dtype=np.int64)
    if faces.ndim != 2 or faces.shape[-1] != 3 or len(faces) < 4 or vertices.ndim != 2:
        raise MeshRefusedError(f"{path.name} holds no surface ({len(faces)} triangles): {expected}.")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise MeshRefusedError(f"{path.name} has faces of vertices that it does not have: {expected}.")
    finite: NDArray[np.bool_] = np.isfinite(vertices).min(axis=1)
    faces = faces[finite[faces].min(axis=1)]
    if len(faces) < 4 or np.ptp(vertices[faces].reshape(-1, 3), axis=0).max() <= 0:
        raise MeshRefusedError(f"{path.name} holds no surface with finite coordinates: {expected}.")
    used, faces = np.unique(faces, return_inverse=True)
    vertices = vertices[used]
    low, high = np.percentile(vertices, [_STRAY, 100 - _STRAY], axis=0)
    most, usual = np.ptp(vertices, axis=0).max(), (high - low).max()
    if most > _MOST_STRAY * usual:
        raise MeshRefusedError(
            f"{path.name} has stray vertices: most lie within {usual:.3g}, all within {most:.3g} of its unit; remove "
            "those far off."
        )
    return Triangles(vertices, faces.reshape(-1, 3))


def clean_triangles(mesh: Triangles, *, most_faces: int = MOST_FACES) -> tuple[Triangles, tuple[str, ...]]:
    """Welds vertices, drops degenerate and repeated faces, and thins out what is too fine; notes what was done.

    Args:
        most_faces: above so many faces vertices are gathered in cells of a five-hundredth of the extent.
    """
    notes = []
    count = len(mesh.faces)
    cleaned = _cluster(mesh, _WELD * mesh.extent)
    if count - len(cleaned.faces):
        notes.append(f"{count - len(cleaned.faces)} degenerate or repeated faces dropped")
    if len(cleaned.faces) > most_faces:
        before = len(cleaned.faces)
        cleaned = _cluster(cleaned, cleaned.extent / _CLUSTERS)
        notes.append(f"{before} faces thinned out to {len(cleaned.faces)}")
    return cleaned, tuple(notes)


def _cluster(mesh: Triangles, cell: float) -> Triangles:
    """One vertex, their mean, for all vertices in a cell; faces that thereby collapse or coincide go."""
    low = mesh.bounds[0]
    cells = np.rint((mesh.vertices - low) / cell).astype(np.int64)
    cells = np.clip(cells, -1, 2**20 - 2) + 1
    key = (cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2]
    _, inverse, count = np.unique(key, return_inverse=True, return_counts=True)
    inverse = inverse.reshape(-1)
    vertices = np.stack([np.bincount(inverse, mesh.vertices[:, k]) / count for k in range(3)], axis=1)
    faces = inverse[mesh.faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    ordered = np.sort(faces, axis=1)
    order = np.lexsort(ordered.T)
    ordered = ordered[order]
    first = np.ones(len(ordered), dtype=bool)
    first[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    return Triangles(vertices, faces[np.sort(order[first])])


def check_unit(unit: str | None) -> None:
    """Raises `MeshRefusedError` for an unknown unit; None: to be detected."""
    if unit is not None and unit not in UNITS:
        raise MeshRefusedError(f"unknown unit {unit!r}; choose from {', '.join(UNITS)}, or leave it out.")


@dataclass(frozen=True)
class Size:
    """How large a lumen is, in the file's unit: width of its widest ball, longest side of the whole."""

    width: float
    extent: float

    def score(self, unit: str) -> float:
        """How far it is from an aorta in a unit; 0: it has an aorta's width and extent."""
        metres = UNITS[unit]
        width, extent = self.width * metres / _WIDTH, self.extent * metres / _EXTENT
        return math.log(width) ** 2 + _EXTENT_WEIGHT * math.log(extent) ** 2

    def in_order(self) -> list[str]:
        """The units, the one that fits best first."""
        return sorted(UNITS, key=self.score)

    def in_words(self, unit: str) -> str:
        """Width and extent in a unit, in words."""
        width, extent = (1e3 * UNITS[unit] * length for length in (self.width, self.extent))
        return f"its widest vessel is then {width:.3g} mm wide and the whole {extent:.3g} mm long"

    def hint(self, unit: str) -> str:
        """What speaks against a given unit; empty where it fits about as well as any."""
        best = self.in_order()[0]
        if best == unit or self.score(best) > _WORST or self.score(unit) - self.score(best) < _CLOSE:
            return ""
        return f"in {unit} {self.in_words(unit)}; {best} would fit ({self.width * UNITS[best] * 1e3:.3g} mm wide)"


def measure_size(mesh: Triangles, budget: Budget) -> Size:
    """Measures the widest ball in a lumen, and the whole, at a rough resolution, in the file's unit.

    Raises:
        MeshRefusedError: there is no lumen.
    """
    spacing = mesh.extent / _VOXELS
    samples = sample_surface(mesh.corners, 0.7 * spacing, budget)
    return Size(2 * find_cavity(samples, spacing, in_metres=False).widest, mesh.extent)


def detect_unit(size: Size) -> tuple[str, str, tuple[str, ...]]:
    """Finds the unit from the width of the widest ball in the lumen, and from the extent of the whole.

    Returns:
        One of UNITS, the reason in words, and a note where it is unsure.

    Raises:
        MeshRefusedError: in no unit it could be an aorta's.
    """
    best, second = size.in_order()[:2]
    width = f"its widest vessel is then {size.width * UNITS[best] * 1e3:.3g} mm wide"
    if size.score(best) > _WORST:
        raise MeshRefusedError(
            f"in no unit is this an aorta ({best} comes nearest, {width}, and the whole "
            f"{size.extent * UNITS[best] * 1e3:.3g} mm long); if it is one, give its unit."
        )
    if size.score(second) - size.score(best) >= _CLOSE:
        return best, f"detected: {width}, as an aorta is", ()
    other = f"{second} could be meant ({size.width * UNITS[second] * 1e3:.3g} mm wide): give the unit to be sure"
    return (
        best,
        f"detected: {width}, as an aorta is; but {other}",
        (f"the unit is unsure: {best} is taken, but {other}",),
    )
