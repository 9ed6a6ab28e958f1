"""Triangles of a surface: read, checked, welded, thinned out where they are too fine, and their unit of length."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.cavity import find_cavity
from cathsim.anatomy.mesh.files.obj_off import read_obj, read_off
from cathsim.anatomy.mesh.files.scenes import read_ply, read_scene
from cathsim.anatomy.mesh.files.stl import read_stl
from cathsim.anatomy.mesh.files.surface import MOST_BYTES, MOST_TRIANGLES, SurfaceFile
from cathsim.anatomy.mesh.files.vtk_legacy import read_legacy_vtk
from cathsim.anatomy.mesh.files.vtp import read_vtp
from cathsim.anatomy.mesh.lattice import Budget
from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.mesh.samples import bounds_of, sample_surface
from cathsim.guarded_reading import UnreadableFileError, check_regular, open_regular

SCENES = (".glb", ".gltf")
BY_TRIMESH = (".ply", *SCENES)
SUFFIXES = (".stl", ".obj", *BY_TRIMESH, ".off", ".vtp", ".vtk")
FORMATS = "STL, OBJ, PLY, OFF, VTP, VTK or GLB"
_PARAVIEW = "ParaView (Extract Surface, then save as VTP)"
_CONVERTERS = {
    **dict.fromkeys((".vtu", ".vtm", ".vtmb", ".pvtp", ".pvtu", ".case", ".msh"), _PARAVIEW),
    **dict.fromkeys((".step", ".stp", ".iges", ".igs", ".brep"), "FreeCAD (mesh it, then export STL)"),
    **dict.fromkeys((".3mf", ".dae", ".fbx", ".blend", ".usd", ".usdz"), "Blender (export GLB)"),
    **dict.fromkeys((".3ds", ".wrl", ".x3d"), "MeshLab (export PLY)"),
    **dict.fromkeys((".hdr", ".img", ".gipl", ".mgh", ".mgz", ".vti"), "3D Slicer (save as NRRD)"),
}
_READERS: dict[str, Callable[[bytes], list[tuple[str, SurfaceFile]]]] = {
    ".stl": read_stl,
    ".obj": read_obj,
    ".ply": lambda content: [("", read_ply(content))],
    ".off": lambda content: [("", read_off(content))],
    ".vtp": lambda content: [("", read_vtp(content))],
    ".vtk": lambda content: [("", read_legacy_vtk(content))],
}
_OWN_WORDS = (".stl", ".vtp", ".vtk")  # the readers of these say what is wrong
MOST_FACES = 400_000  # above this a mesh is thinned out
_STRAY, _MOST_STRAY = 0.5, 10.0  # % of vertices at either side, and how many times further than the others they may lie
_MOST_LOST = 0.2  # of a surface's faces that may be missing
_WELD = 1e-5  # of the largest extent: vertices nearer than this are one
_CLUSTERS = 500  # cells along the largest extent when a mesh is thinned out

UNITS: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}
_WIDTHS = (0.009, 0.036)  # m, of an aorta at its widest place: a newborn's ... an adult's
_EXTENTS = (0.06, 0.45)  # m, of a model: a newborn's arch ... from the groin to the neck
_USUAL = 0.024  # m wide
_EXTENT_WEIGHT, _USUAL_WEIGHT = 0.25, 0.05
_RARE = {"inch": 0.3}  # scans and their models come in metric units: a child's in centimetres is no adult's in inches
_STOUT = 0.5  # of its extent: a vessel is less wide
_STOUT_WEIGHT = 4.0
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
        return bounds_of(self.vertices[self._used])

    @property
    def extent(self) -> float:
        """Longest side of the bounding box."""
        return float(np.ptp(self.bounds, axis=0).max())

    def scaled(self, factor: float) -> Triangles:
        """The same triangles in another unit, by the factor of an old unit in new ones."""
        return Triangles(self.vertices * factor, self.faces)

    def compact(self) -> Triangles:
        """The same triangles without vertices that none uses."""
        used = self._used
        return Triangles(self.vertices[used], (np.cumsum(used) - 1)[self.faces])

    @property
    def _used(self) -> NDArray[np.bool_]:
        used = np.zeros(len(self.vertices), dtype=bool)
        used[self.faces] = True
        return used

    def welded(self) -> Triangles:
        """The same triangles with one vertex for all that lie within a hundred-thousandth of the extent."""
        return _cluster(self, _WELD * self.extent)


def is_mesh_path(name: str | Path) -> bool:
    """Whether a phantom's name is a path to a surface: it ends like one, or is a folder that holds such files."""
    path = Path(name)
    if os.path.isdir(path):  # False, too, for a name that no file can have
        return any(file.suffix.lower() in SUFFIXES and file.name[0] != "." for file in path.iterdir())
    return path.name.lower().endswith(SUFFIXES)


def check_file(path: Path) -> None:
    """Raises `MeshRefusedError` for a file that is missing, empty, too large, no regular file or of another kind."""
    if not path.exists():
        raise MeshRefusedError(f"there is no file {path}; give the path of an {FORMATS} file.")
    if path.suffix.lower() not in SUFFIXES:
        raise MeshRefusedError(f"{path.name} is none of {', '.join(SUFFIXES)}; convert it {converter(path)}.")
    try:
        size = check_regular(path, MOST_BYTES)
    except UnreadableFileError as error:
        raise MeshRefusedError(str(error)) from None
    if size == 0:
        raise MeshRefusedError(f"{path.name} is empty; export the mesh again.")


def converter(path: Path) -> str:
    """Words on what turns a file of another kind into one that is read."""
    program = _CONVERTERS.get(path.suffix.lower())
    return f"to one of them with {program}" if program else "to one of them"


@dataclass(frozen=True, eq=False)
class NamedSurface:
    """A checked surface of a file, or of a node of a scene.

    Attributes:
        name: of the node, object or solid; empty for a file that is one surface.
        mesh: its triangles, in the file's unit and frame.
        space: "LPS" or "RAS", the patient's frame that the coordinates are in; empty where the file does not say.
        notes: what of the file was not as it should be.
    """

    name: str
    mesh: Triangles
    space: str = ""
    notes: tuple[str, ...] = ()


def read_surfaces(path: Path) -> list[NamedSurface]:
    """Reads the surfaces of a file as they are, without any guard against what its reader may do.

    Raises:
        MeshRefusedError: for a file that is missing, empty, too large or no such mesh.
    """
    check_file(path)
    suffix = path.suffix.lower()
    try:
        if suffix in SCENES:
            raw_surfaces = read_scene(path)
        else:
            with open_regular(path, MOST_BYTES) as file:
                raw_surfaces = _READERS[suffix](file.read())
    except (MemoryError, MeshRefusedError):
        raise
    except UnreadableFileError as error:
        raise MeshRefusedError(str(error)) from None
    except Exception as error:  # the readers of several formats raise what they like on damaged files
        own = type(error) is ValueError and (suffix in _OWN_WORDS or str(error).startswith("it promises"))
        raise MeshRefusedError(
            f"{path.name} cannot be read as a mesh: {f'{error}; export it again' if own else _expected(path)}."
        ) from error
    if not raw_surfaces:
        raise MeshRefusedError(f"{path.name} holds no surface: {_expected(path)}.")
    surfaces = []
    for name, one in raw_surfaces:
        mesh = checked_triangles(one.vertices, one.faces, path)
        lost = len(one.faces) - len(mesh.faces)
        notes = (f"{lost} of its {len(one.faces)} faces lack finite coordinates and are left out",) if lost else ()
        surfaces.append(NamedSurface(name, mesh, one.space, (*one.notes, *notes)))
    return surfaces


def _expected(path: Path) -> str:
    return f"expected a triangle mesh in {path.suffix[1:].upper()} format; export it again"


def checked_triangles(vertices: Array, faces: Indices, path: Path) -> Triangles:
    """Triangles of a file, without the few of infinite coordinates and vertices that no triangle uses.

    Raises:
        MeshRefusedError: there is no surface, or vertices lie far off.
    """
    expected = _expected(path)
    if len(faces) > MOST_TRIANGLES:
        raise MeshRefusedError(
            f"{path.name} has {len(faces)} triangles, at most {MOST_TRIANGLES} are read; simplify it."
        )
    if faces.ndim != 2 or faces.shape[-1] != 3 or len(faces) < 4 or vertices.ndim != 2:
        raise MeshRefusedError(f"{path.name} holds no surface ({len(faces)} triangles): {expected}.")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise MeshRefusedError(f"{path.name} has faces of vertices that it does not have: {expected}.")
    finite: NDArray[np.bool_] = np.isfinite(vertices).min(axis=1)
    count, faces = len(faces), faces[finite[faces].min(axis=1)]
    if (
        len(faces) < (1 - _MOST_LOST) * count
        or len(faces) < 4
        or np.ptp(vertices[faces].reshape(-1, 3), axis=0).max() <= 0
    ):
        raise MeshRefusedError(f"{path.name} holds no surface with finite coordinates: {expected}.")
    mesh = Triangles(vertices, faces).compact()
    low, high = np.percentile(mesh.vertices, [_STRAY, 100 - _STRAY], axis=0)
    most, usual = np.ptp(mesh.vertices, axis=0).max(), (high - low).max()
    if most > _MOST_STRAY * usual:
        raise MeshRefusedError(
            f"{path.name} has stray vertices: most lie within {usual:.3g}, all within {most:.3g} of its unit; remove "
            "those far off."
        )
    return mesh


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
        """How far it is from an aorta in a unit; near 0: it has an aorta's width and extent."""
        width, extent = self.width * UNITS[unit], self.extent * UNITS[unit]
        score = _beyond(width, _WIDTHS) + _EXTENT_WEIGHT * _beyond(extent, _EXTENTS) + _RARE.get(unit, 0.0)
        stout = max(math.log(width / extent / _STOUT), 0.0)
        return score + _USUAL_WEIGHT * math.log(width / _USUAL) ** 2 + _STOUT_WEIGHT * stout**2

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


def _beyond(length: float, usual: tuple[float, float]) -> float:
    """How far a length is from a range, as the square of a logarithm."""
    low, high = usual
    return math.log(min(max(length, low), high) / length) ** 2


def measure_size(mesh: Triangles, budget: Budget) -> Size:
    """Measures the widest ball in a lumen, and the whole, at a rough resolution, in the file's unit.

    Raises:
        MeshRefusedError: there is no lumen.
    """
    for spacing in (mesh.extent / _VOXELS, mesh.extent / _VOXELS / 2):  # a tree from the groin to the head is slim
        samples = sample_surface(mesh.corners, 0.7 * spacing, budget)
        try:
            return Size(2 * find_cavity(samples, spacing, rough=True).widest, mesh.extent)
        except MeshRefusedError as error:
            refusal = error
    raise refusal


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
