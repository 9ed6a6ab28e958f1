"""Surfaces that trimesh reads: OBJ, PLY and OFF, and glTF scenes with names; of their references only data is read."""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from cathsim.anatomy.mesh.files.ply import read_polygons
from cathsim.anatomy.mesh.files.surface import MOST_BYTES, MOST_NODES, MOST_TRIANGLES, SurfaceFile, space_of_comment
from cathsim.guarded_reading import UnreadableFileError, open_regular, referenced_file

_PACKED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")


def read_mesh(path: Path) -> SurfaceFile:
    """Reads an OBJ, PLY or OFF file without its materials and textures.

    Raises:
        Exception: whatever trimesh raises on a damaged file.
    """
    import trimesh

    with open_regular(path, MOST_BYTES) as file:
        content = file.read()
    kind = path.suffix[1:].lower()
    try:
        loaded = trimesh.load(
            BytesIO(content), file_type=kind, force="mesh", process=False, skip_materials=True, resolver={}
        )
    except ValueError:
        if kind != "ply":
            raise
        return read_polygons(content)
    vertices = np.asarray(getattr(loaded, "vertices", np.zeros((0, 3))), dtype=np.float64)
    return SurfaceFile(
        vertices, np.asarray(getattr(loaded, "faces", np.zeros((0, 3))), dtype=np.int64), space_of_comment(content)
    )


def read_scene(path: Path) -> list[tuple[str, SurfaceFile]]:
    """Reads the nodes of a glTF scene by name, in the scene's frame.

    Raises:
        UnreadableFileError: the scene is too large, compressed, or refers to a file out of its folder.
        Exception: whatever trimesh raises on a damaged file.
    """
    import trimesh

    beside = {name: referenced_file(path, unquote(name), MOST_BYTES).read_bytes() for name in _references(path)}
    with open_regular(path, MOST_BYTES) as file:
        content = file.read()
    kind = path.suffix[1:].lower()
    scene = trimesh.load_scene(BytesIO(content), file_type=kind, skip_materials=True, resolver=beside)
    nodes = [(str(node), *scene.graph[node]) for node in scene.graph.nodes_geometry]
    meshes = [(name, pose, scene.geometry[key]) for name, pose, key in nodes]
    meshes = [one for one in meshes if isinstance(one[2], trimesh.Trimesh) and len(one[2].faces)]
    total = sum(len(mesh.faces) for _, _, mesh in meshes)
    if total > MOST_TRIANGLES:
        raise UnreadableFileError(
            f"{path.name} has {total} triangles in {len(meshes)} nodes, at most {MOST_TRIANGLES} are read; simplify it."
        )
    return [
        (name, SurfaceFile(trimesh.transform_points(mesh.vertices, pose), np.asarray(mesh.faces, dtype=np.int64)))
        for name, pose, mesh in meshes
    ]


def referenced_data(path: Path) -> list[Path]:
    """The files that the data of a glTF scene stands in, besides its own; none for other kinds of files.

    Raises:
        UnreadableFileError: one of them is no regular file of the scene's own folder.
    """
    return [referenced_file(path, unquote(name), MOST_BYTES) for name in _references(path)]


def _references(path: Path) -> list[str]:
    """Names of the files that a scene's data stands in, as they stand in it."""
    with open_regular(path, MOST_BYTES) as file:
        content = file.read()
    if content.startswith(b"glTF"):  # binary: a header of 12 bytes, then length and kind of the first part, in JSON
        content = content[20 : 20 + int.from_bytes(content[12:16], "little")]
    try:
        tree = json.loads(content)
        uris = [buffer.get("uri", "data:") for buffer in tree.get("buffers", [])]
        nodes, packed = len(tree.get("nodes", [])), set(tree.get("extensionsRequired", [])) & set(_PACKED)
    except Exception as error:  # of a damaged file
        raise UnreadableFileError(f"{path.name} cannot be read as a glTF scene ({error}); export it again.") from error
    if nodes > MOST_NODES:
        raise UnreadableFileError(
            f"{path.name} has {nodes} nodes, at most {MOST_NODES} are read; export the vessels alone."
        )
    if packed:
        raise UnreadableFileError(f"{path.name} is compressed ({', '.join(packed)}); export it without compression.")
    return [str(uri) for uri in uris if not str(uri).startswith("data:")]
