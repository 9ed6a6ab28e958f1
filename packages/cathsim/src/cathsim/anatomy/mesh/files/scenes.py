"""Surfaces that trimesh reads: PLY, and glTF scenes with names; of their references only data is read."""

from __future__ import annotations

import json
import re
from io import BytesIO
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from cathsim.anatomy.mesh.files.surface import (
    MOST_BYTES,
    MOST_NODES,
    MOST_TRIANGLES,
    SurfaceFile,
    rows_beyond,
    space_of_comment,
    triangles_of_cells,
)
from cathsim.guarded_reading import UnreadableFileError, open_regular, referenced_file

_PACKED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")
_FAN = 6  # a primitive's mode


_ORDERS = {b"binary_little_endian": "little", b"binary_big_endian": "big"}
_TYPES = {
    b"char": "i1", b"int8": "i1", b"uchar": "u1", b"uint8": "u1", b"short": "i2", b"int16": "i2", b"ushort": "u2",
    b"uint16": "u2", b"int": "i4", b"int32": "i4", b"uint": "u4", b"uint32": "u4", b"float": "f4", b"float32": "f4",
    b"double": "f8", b"float64": "f8",
}  # fmt: skip
_END = b"end_header\n"


def read_ply(content: bytes) -> SurfaceFile:
    """Reads a PLY file without its materials and textures.

    Raises:
        Exception: whatever trimesh raises on a damaged file.
    """
    import trimesh

    try:
        loaded = trimesh.load(
            BytesIO(content), file_type="ply", force="mesh", process=False, skip_materials=True, resolver={}
        )
    except ValueError:
        return read_polygons(content)
    vertices, faces = (np.asarray(getattr(loaded, key, np.zeros((0, 3)))) for key in ("vertices", "faces"))
    notes = _rows_beyond(content)
    return SurfaceFile(vertices.astype(np.float64), faces.astype(np.int64), space_of_comment(content), notes)


def _rows_beyond(content: bytes) -> tuple[str, ...]:
    """A note on rows behind those that the head of a PLY file of text promises; none where there are none.

    Raises:
        ValueError: there are less, or so many more that the head is wrong.
    """
    if not re.search(rb"^format +ascii", content, re.MULTILINE):
        return ()
    rows = [row for row in content.splitlines() if row.strip()]
    end = next(k for k, row in enumerate(rows) if row.strip() == b"end_header")
    promised = sum(int(row.split()[2]) for row in rows[:end] if row.startswith(b"element "))
    return rows_beyond(promised, len(rows) - end - 1)


def read_scene(path: Path) -> list[tuple[str, SurfaceFile]]:
    """Reads the nodes of a glTF scene by name, all primitives of one together, in the scene's frame.

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
    nodes = [(_name(scene, str(node)), *scene.graph[node]) for node in scene.graph.nodes_geometry]
    meshes = [(name, pose, scene.geometry[key]) for name, pose, key in nodes]
    meshes = [one for one in meshes if isinstance(one[2], trimesh.Trimesh) and len(one[2].faces)]
    total, taken = sum(len(mesh.faces) for _, _, mesh in meshes), dict.fromkeys(name for name, _, _ in meshes)
    if total > MOST_TRIANGLES:
        raise UnreadableFileError(
            f"{path.name} has {total} triangles in {len(taken)} nodes, at most {MOST_TRIANGLES} are read; simplify it."
        )
    bare = list(dict.fromkeys(name for name, _, _ in nodes if name not in taken))
    notes = (f"{len(bare)} nodes without triangles are left out: {', '.join(bare[:4])}",) if bare else ()
    parts: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {name: [] for name in taken}
    for name, pose, mesh in meshes:
        parts[name].append((trimesh.transform_points(mesh.vertices, pose), mesh.faces))
    joined = {name: trimesh.util.append_faces(*zip(*own, strict=True)) for name, own in parts.items()}
    return [
        (name, SurfaceFile(vertices.astype(np.float64), faces.astype(np.int64), "", notes))
        for name, (vertices, faces) in joined.items()
    ]


def _name(scene: Any, node: str) -> str:
    """The name of a node as the file has it; below it trimesh gives each of several primitives one, named by chance."""
    (_, key), parent = scene.graph[node], scene.graph.transforms.parents[node]
    several = scene.geometry[key].metadata.get("from_gltf_primitive")
    return str(parent) if several and node[: -len("_abc123")] == parent else node


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
        parts = [part for mesh in tree.get("meshes", []) for part in mesh["primitives"]]
        used = {part.get("indices") for part in parts} | {part["attributes"].get("POSITION") for part in parts}
        odd = [k for k in used - {None} if {"sparse", "normalized"} & set(tree["accessors"][k])]
        nodes, packed = len(tree.get("nodes", [])), set(tree.get("extensionsRequired", [])) & set(_PACKED)
    except Exception as error:  # of a damaged file
        raise UnreadableFileError(f"{path.name} cannot be read as a glTF scene ({error}); export it again.") from error
    if nodes > MOST_NODES:
        raise UnreadableFileError(
            f"{path.name} has {nodes} nodes, at most {MOST_NODES} are read; export the vessels alone."
        )
    if odd or any(part.get("mode") == _FAN for part in parts):
        raise UnreadableFileError(
            f"{path.name} has fans of triangles, or sparse or normalized numbers, which are not read; export it again "
            "as plain triangles."
        )
    if packed:
        raise UnreadableFileError(f"{path.name} is compressed ({', '.join(packed)}); export it without compression.")
    return [str(uri) for uri in uris if not str(uri).startswith("data:")]


def read_polygons(content: bytes) -> SurfaceFile:
    """Reads a binary PLY file's vertices and faces, and divides its polygons into fans of triangles.

    Raises:
        Exception: it is text, cut off, or has other parts than vertices, faces and simple numbers.
    """
    head, _, data = content.partition(_END)
    lines = [line.split() for line in head.split(b"\n")]
    order = _ORDERS[next(words[1] for words in lines if words[:1] == [b"format"])]
    sign = "<" if order == "little" else ">"
    vertices, corners, ends, at = np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros(0, np.int64), 0
    notes: tuple[str, ...] = ()
    for number, words in enumerate(lines):
        if words[:1] != [b"element"]:
            continue
        count = int(words[2])
        fields: list[list[bytes]] = []
        for line in lines[number + 1 :]:
            if line[:1] == [b"element"]:
                break
            fields += [line[1:]] if line[:1] == [b"property"] else []
        if words[1] == b"face":
            corners, ends, at = _polygons(data, at, count, fields, order)
            more = 0 if any(words[:1] == [b"element"] for words in lines[number + 1 :]) else len(data) - at
            notes = (f"{more} bytes behind its {count} faces are left out",) if more else ()
            if more > 0.2 * len(data):
                raise ValueError("its head promises less faces than it holds")
            break  # other elements behind the faces are not needed
        kind = np.dtype([(field[1].decode(), sign + _TYPES[field[0]]) for field in fields])
        if words[1] == b"vertex":
            records = np.frombuffer(data, kind, count, at)
            vertices = np.stack([records[axis].astype(np.float64) for axis in "xyz"], axis=1)
        at += count * kind.itemsize
    return SurfaceFile(vertices, triangles_of_cells(corners, ends, strips=False), space_of_comment(content), notes)


def _polygons(
    data: bytes, at: int, count: int, fields: list[list[bytes]], order: str
) -> tuple[np.ndarray, np.ndarray, int]:
    """Corners of one face after the other, where each face ends among them, and where all end in the data."""
    (place,) = (k for k, field in enumerate(fields) if field[0] == b"list")
    before, after = (
        sum(np.dtype(_TYPES[field[0]]).itemsize for field in part) for part in (fields[:place], fields[place + 1 :])
    )
    length, corner = (np.dtype(("<" if order == "little" else ">") + _TYPES[name]) for name in fields[place][1:3])
    if count * (before + length.itemsize + after) > len(data):
        raise ValueError("it is cut off")
    if length.itemsize != 1:
        raise ValueError("it counts a polygon's corners in other numbers than bytes")
    sizes, starts, width = [], [], corner.itemsize
    for _ in range(count):
        at += before
        size = data[at]  # IndexError: it is cut off
        sizes.append(size)
        starts.append(at + 1)
        at += 1 + size * width + after
    if at > len(data):
        raise ValueError("it is cut off")
    ends = np.cumsum(np.array(sizes, np.int64))
    shift = np.array(starts, np.int64) - corner.itemsize * (ends - sizes)
    places = np.repeat(shift, sizes) + corner.itemsize * np.arange(ends[-1] if count else 0)
    octets = np.frombuffer(data, np.uint8)[places[:, None] + np.arange(corner.itemsize)]
    return octets.view(corner)[:, 0], ends, at
