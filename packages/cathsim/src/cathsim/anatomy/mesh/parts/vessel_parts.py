"""Surfaces that come in parts: the nodes of a scene, the files of a folder, the pieces of one file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.reading import SCENES, SUFFIXES, Triangles, check_file, checked_triangles, read_triangles
from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.vessel_names import ACCESS, AORTA, SUPRA_AORTIC, vessel_name

_TAKEN = (AORTA, *SUPRA_AORTIC, *ACCESS, "carotid_trunk", "subclavian_trunk", "vertebral_left", "vertebral_right")
_LEAST_PIECE = 0.04  # of the whole's longest side: a smaller piece is dust
_LEAST_FACES = 12  # of a piece
_OPEN = 0.1  # share of a run's edges that may have one face only
_MOST_PIECES = 60  # more is no anatomy in parts, but a torn surface
_SHOWN = 4  # names in a note


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
    return sorted(file for file in path.iterdir() if file.name.lower().endswith(tuple(suffixes)))


def read_parts(path: Path) -> tuple[list[Part], int, tuple[str, ...]]:
    """Reads all parts that belong to the aorta and the vessels of head, arms and access.

    Args:
        path: a file of a surface, or a folder with one a vessel.

    Returns:
        The parts, in the file's unit; the number of triangles read; notes on what was left out.

    Raises:
        MeshRefusedError: there is no surface, or no part of an aorta among named ones.
    """
    if path.is_dir():
        files = folder_files(path)
        if not files:
            raise MeshRefusedError(f"{path.name} holds no surface ({', '.join(SUFFIXES)}); give a folder that does.")
        named = [(_stem(file), read_triangles(file)) for file in files]
    elif path.suffix.lower() in SCENES:
        named = _scene(path)
    else:
        named = [("", read_triangles(path))]
    faces = sum(len(mesh.faces) for _, mesh in named)
    known = [(vessel_name(name), name, mesh) for name, mesh in named]
    notes: tuple[str, ...] = ()
    if any(vessel for vessel, _, _ in known):
        if not any(vessel == AORTA for vessel, _, _ in known):
            raise MeshRefusedError(
                f"{path.name} has {len(named)} parts with names, none of them an aorta's "
                f"({_some(n for n, _ in named)}); add it, or name it aorta."
            )
        dropped = [name for vessel, name, _ in known if vessel not in _TAKEN]
        if dropped:
            notes = (
                f"{len(dropped)} of {len(named)} parts left out, which are no way to head or arms: {_some(dropped)}",
            )
        known = [one for one in known if one[0] in _TAKEN]
    parts = [Part(vessel, piece) for vessel, _, mesh in known for piece in pieces(mesh)]
    return parts, faces, notes


def pieces(mesh: Triangles) -> list[Triangles]:
    """The parts of a surface that do not hang together, by triangles that share corners; walls around walls stay one.

    Closed parts that one file holds one after the other are apart even where their corners coincide. Small pieces are
    dropped where there are others.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    welded = mesh.welded()
    a, b, c = welded.faces.T
    count = len(welded.vertices)
    graph = coo_matrix((np.ones(2 * len(a)), (np.r_[a, a], np.r_[b, c])), shape=(count, count))
    _, labels = connected_components(graph, directed=False)
    runs = _closed_runs(welded.faces)
    of_face = labels[welded.faces[:, 0]].astype(np.int64) * (int(runs.max()) + 1) + runs
    if len(np.unique(of_face)) == 1:
        return [mesh]
    order = np.argsort(of_face, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(of_face[order])) + 1)
    found = []
    for group in groups:
        corners = welded.vertices[welded.faces[group]].reshape(-1, 3)
        low, high = corners.min(axis=0), corners.max(axis=0)
        if len(group) >= _LEAST_FACES and (high - low).max() >= _LEAST_PIECE * mesh.extent:
            found.append((group, low, high))
    if not 2 <= len(found) <= _MOST_PIECES:
        return [mesh]
    found.sort(key=lambda one: -float(np.linalg.norm(one[2] - one[1])))
    shells: list[tuple[list, np.ndarray, np.ndarray]] = []
    for group, low, high in found:
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
    order = np.lexsort((of_edge, edges[:, 1], edges[:, 0]))
    ordered, at = edges[order], of_edge[order]
    first = np.r_[True, (np.diff(ordered, axis=0) != 0).any(axis=1)]
    nth = np.arange(len(at)) - np.maximum.accumulate(np.where(first, np.arange(len(at)), 0))
    single = (nth % 2 == 0) & np.r_[first[1:], True]
    opened = np.bincount(at, np.where(single, 0, np.where(nth % 2 == 0, 1, -1)), minlength=len(faces))
    closed = np.cumsum(opened) == 0
    runs = np.r_[0, np.cumsum(closed)[:-1]].astype(np.int64)
    of_run = np.unique(np.column_stack([runs[at], ordered]), axis=0, return_counts=True)
    odd = np.bincount(of_run[0][:, 0], of_run[1] % 2)
    size = np.bincount(runs)
    if (odd > _OPEN * 1.5 * size)[size >= _LEAST_FACES].any():
        return np.zeros(len(faces), dtype=np.int64)
    return runs


def _scene(path: Path) -> list[tuple[str, Triangles]]:
    """Nodes of a glTF scene by name, in the scene's frame."""
    import trimesh

    check_file(path)
    try:
        scene = trimesh.load_scene(path)
        named = []
        for node in scene.graph.nodes_geometry:
            transform, geometry = scene.graph[node]
            mesh = scene.geometry[geometry]
            if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
                vertices = trimesh.transform_points(mesh.vertices, transform)
                named.append((str(node), Triangles(vertices, np.asarray(mesh.faces, dtype=np.int64))))
    except Exception as error:
        raise MeshRefusedError(
            f"{path.name} cannot be read as a glTF scene: expected triangle meshes in GLB format; export it again."
        ) from error
    if not named:
        raise MeshRefusedError(f"{path.name} holds no surface: expected triangle meshes in GLB format.")
    return [(name, checked_triangles(mesh.vertices, mesh.faces, path)) for name, mesh in named]


def _stem(path: Path) -> str:
    return path.name.split(".")[0]


def _some(names: Iterable[str]) -> str:
    names = list(names)
    return ", ".join(names[:_SHOWN]) + (", …" if len(names) > _SHOWN else "")
