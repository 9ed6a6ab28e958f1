"""Surfaces that come in parts: the nodes of a scene, the files of a folder, the pieces of one file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.files.scenes import referenced_data
from cathsim.anatomy.mesh.reading import (
    BY_TRIMESH,
    MOST_FACES,
    SCENES,
    SUFFIXES,
    NamedSurface,
    Triangles,
    check_file,
    read_surfaces,
)
from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.vessel_names import ACCESS, AORTA, SUPRA_AORTIC, is_other, not_taken, of_one_name, vessel_name
from cathsim.guarded_reading import UnreadableFileError, call_in_child
from cathsim.lattice.node_set import linked_parts

Result = TypeVar("Result")

_OF_ARCH = {*SUPRA_AORTIC, "carotid_trunk", "subclavian_trunk", "vertebral_left", "vertebral_right"}
_TAKEN = {AORTA, *ACCESS, *_OF_ARCH}  # where there is one of an arch; without, every known artery
_LEAST_PIECE = 0.04  # of the whole's longest side: a smaller piece is dust
_LEAST_FACES = 12  # of a piece
_OPEN = 0.1  # share of a run's edges that may have one face only
_MOST_PIECES = 60  # more is no anatomy in parts, but a torn surface
_SHOWN = 4  # names in a note
_SECONDS = 120.0  # for reading, as for the rest of an import
# rows are the patient's left, posterior and superior axis in a frame that a file names
_FRAMES = {"LPS": np.eye(3), "RAS": np.diag((-1.0, -1.0, 1.0))}


@dataclass(frozen=True, eq=False)
class Part:
    """One part of an anatomy."""

    name: str  # the project's name of the vessel; empty where it is not known
    mesh: Triangles


def is_folder_of_parts(path: Path, suffixes: Sequence[str] = SUFFIXES) -> bool:
    """Whether a folder is one anatomy with a file for each vessel: an aorta among them, at least half known by name."""
    if not path.is_dir():
        return False
    names = [vessel_name(_stem(file)) for file in folder_files(path, suffixes)]
    return AORTA in names and len(set(names) - {""}) >= 2 and 2 * sum(map(bool, names)) >= len(names)


def folder_files(path: Path, suffixes: Sequence[str] = SUFFIXES) -> list[Path]:
    """The files of a folder that end in one of some suffixes, in order of their names."""
    visible = (file for file in path.iterdir() if not file.name.startswith("."))
    return sorted(file for file in visible if file.name.lower().endswith(tuple(suffixes)))


@dataclass(frozen=True, eq=False)
class Surface:
    """What is read of an anatomy's files.

    Attributes:
        parts: that belong to the aorta and the vessels of head, arms and access, in the file's unit and frame.
        faces: number of triangles read.
        notes: what was left out, or not as it should be.
        frame: (3, 3) rows are the patient's left, posterior and superior axis in the file's frame; None where the
            files do not say.
    """

    parts: list[Part]
    faces: int
    notes: tuple[str, ...]
    frame: NDArray[np.float64] | None


def surface_files(path: Path) -> list[Path]:
    """The checked files that the surfaces of a path stand in: itself or those of a folder, and data that they refer to.

    Raises:
        MeshRefusedError: one of them is missing, too large, no regular file or not of the folder.
    """
    files = folder_files(path) if path.is_dir() else [path]
    for file in files:
        check_file(file)
    scenes = [file for file in files if file.suffix.lower() in SCENES]
    return files + [data for scene in scenes for data in _in_child(referenced_data, scene)]


def read_parts(path: Path) -> Surface:
    """Reads all parts that belong to the aorta and the vessels of head, arms and access, in a child process.

    Args:
        path: a file of a surface, or a folder with one a vessel.

    Raises:
        MeshRefusedError: there is no surface, or no part of an aorta among named ones; or its reader crashed or took
            too much time or memory.
    """
    import scipy.sparse.csgraph  # noqa: F401  what children need is imported once, here

    if any(file.suffix.lower() in BY_TRIMESH for file in surface_files(path)):
        import trimesh  # noqa: F401
    return _in_child(_read_parts, path)


def _in_child(function: Callable[[Path], Result], path: Path) -> Result:
    try:
        return call_in_child(function, path, subject=path.name, seconds=_SECONDS)
    except UnreadableFileError as error:
        raise MeshRefusedError(str(error)) from None


def _read_parts(path: Path) -> Surface:
    if path.is_dir():
        named = [
            replace(
                one,
                name=one.name if is_other(one.name) else _stem(file),
                notes=tuple(f"{file.name}: {note}" for note in one.notes),
            )
            for file in folder_files(path)
            for one in read_surfaces(file)
        ]
    else:
        named = read_surfaces(path)
    notes = tuple(dict.fromkeys(note for one in named for note in one.notes))
    known = [(vessel_name(one.name), one) for one in named]
    if any(vessel for vessel, _ in known):
        if not any(vessel == AORTA for vessel, _ in known):
            raise MeshRefusedError(
                f"{path.name} has {len(named)} parts with names, none of them an aorta's "
                f"({_some(one.name for one in named)}); add it, or name it aorta."
            )
        names = {vessel for vessel, _ in known} - {""}
        taken = _TAKEN if names & _OF_ARCH else names
        dropped = [one.name for vessel, one in known if vessel not in taken]
        if dropped:
            notes += (
                f"{len(dropped)} of {len(named)} parts left out, which are no way to head or arms: {_some(dropped)}",
                *not_taken(dropped, "parts"),
            )
        known = [one for one in known if one[0] in taken]
        notes += of_one_name((one.name for _, one in known), "parts")
    elif others := [one.name for _, one in known if is_other(one.name)]:
        if len(others) == len(known):
            raise MeshRefusedError(
                f"{path.name} has no part that is named after an artery ({_some(others)}); export the aorta with its "
                "branches, or name it aorta."
            )
        notes += not_taken(others, "parts")
        known = [one for one in known if one[1].name not in others]
    parts = [Part(vessel, piece) for vessel, one in known for piece in pieces(one.mesh)]
    # of a very fine surface the vertices of each triangle are joined here, where memory is limited
    parts = [Part(one.name, one.mesh.welded()) if len(one.mesh.faces) > MOST_FACES else one for one in parts]
    return Surface(parts, sum(len(one.mesh.faces) for one in named), notes, _frame(named, path))


def _frame(surfaces: Sequence[NamedSurface], path: Path) -> NDArray[np.float64] | None:
    """The patient's axes in the frame of all surfaces, where they name it."""
    spaces = {one.space for one in surfaces}
    if {"LPS", "RAS"} <= spaces:
        raise MeshRefusedError(f"some files of {path.name} have coordinates in LPS, others in RAS; export all in one.")
    return _FRAMES[spaces.pop()] if len(spaces) == 1 and spaces <= set(_FRAMES) else None


def pieces(mesh: Triangles) -> list[Triangles]:
    """The parts of a surface that do not hang together, by triangles that share corners; walls around walls stay one.

    Closed parts that one file holds one after the other are apart even where their corners coincide. Small pieces are
    dropped where there are others.
    """
    welded = mesh.welded()
    a, b, c = welded.faces.T
    labels = linked_parts(np.r_[a, a], np.r_[b, c], len(welded.vertices))
    runs = _closed_runs(welded.faces)
    of_face = labels[welded.faces[:, 0]].astype(np.int64) * (int(runs.max()) + 1) + runs
    if len(np.unique(of_face)) == 1:
        return [mesh]
    order = np.argsort(of_face, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(of_face[order])) + 1)
    components = []
    for group in groups:
        corners = welded.vertices[welded.faces[group]].reshape(-1, 3)
        low, high = corners.min(axis=0), corners.max(axis=0)
        if len(group) >= _LEAST_FACES and (high - low).max() >= _LEAST_PIECE * mesh.extent:
            components.append((group, low, high))
    if not 2 <= len(components) <= _MOST_PIECES:
        return [mesh]
    components.sort(key=lambda one: -float(np.linalg.norm(one[2] - one[1])))
    shells: list[tuple[list, np.ndarray, np.ndarray]] = []
    for group, low, high in components:
        size = float(np.linalg.norm(high - low))
        slack = 0.02 * size
        for shell in shells:
            within = (low >= shell[1] - slack).all() and (high <= shell[2] + slack).all()
            if within and size > 0.8 * float(np.linalg.norm(shell[2] - shell[1])):
                shell[0].append(group)
                break
        else:
            shells.append(([group], low, high))
    if len(shells) == 1:
        return [mesh]
    return [Triangles(welded.vertices, welded.faces[np.concatenate(shell[0])]).compact() for shell in shells]


def _closed_runs(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number (n,) of the run of each face; a run ends where all edges of the faces so far have met their second face.

    Edges that never do, at openings and missing triangles, do not count. All faces are one run where one of the runs
    is no surface by itself: fins and loose triangles belong to what they stand on.
    """
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    of_edge = np.repeat(np.arange(len(faces)), 3)
    edge = edges[:, 0] * (int(faces.max()) + 1) + edges[:, 1]
    order = np.argsort(edge, kind="stable")  # faces of an edge stay in order
    ordered, at = edge[order], of_edge[order]
    first = np.r_[True, np.diff(ordered) != 0]
    nth = np.arange(len(at)) - np.maximum.accumulate(np.where(first, np.arange(len(at)), 0))
    single = (nth % 2 == 0) & np.r_[first[1:], True]
    opened = np.bincount(at, np.where(single, 0, np.where(nth % 2 == 0, 1, -1)), minlength=len(faces))
    closed = np.cumsum(opened) == 0
    runs = np.r_[0, np.cumsum(closed)[:-1]].astype(np.int64)
    of_run = np.flatnonzero(first | np.r_[True, np.diff(runs[at]) != 0])  # edges of one run after the other
    odd = np.bincount(runs[at[of_run]], np.diff(np.r_[of_run, len(at)]) % 2)
    size = np.bincount(runs)
    if (odd > _OPEN * 1.5 * size)[size >= _LEAST_FACES].any():
        return np.zeros(len(faces), dtype=np.int64)
    return runs


def _stem(path: Path) -> str:
    return path.name.split(".")[0]


def _some(names: Iterable[str]) -> str:
    names = list(names)
    return ", ".join(names[:_SHOWN]) + (", …" if len(names) > _SHOWN else "")
