"""Reader of binary PLY files whose polygons have different numbers of corners, which trimesh does not read."""

from __future__ import annotations

import numpy as np

from cathsim.anatomy.mesh.files.surface import SurfaceFile, space_of_comment, triangles_of_cells

_ORDERS = {b"binary_little_endian": "little", b"binary_big_endian": "big"}
_TYPES = {
    b"char": "i1", b"int8": "i1", b"uchar": "u1", b"uint8": "u1", b"short": "i2", b"int16": "i2", b"ushort": "u2",
    b"uint16": "u2", b"int": "i4", b"int32": "i4", b"uint": "u4", b"uint32": "u4", b"float": "f4", b"float32": "f4",
    b"double": "f8", b"float64": "f8",
}  # fmt: skip
_END = b"end_header\n"


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
            corners, ends = _polygons(data, at, count, fields, order)
            break  # what comes behind the faces is not needed
        kind = np.dtype([(field[1].decode(), sign + _TYPES[field[0]]) for field in fields])
        if words[1] == b"vertex":
            found = np.frombuffer(data, kind, count, at)
            vertices = np.stack([found[axis].astype(np.float64) for axis in "xyz"], axis=1)
        at += count * kind.itemsize
    return SurfaceFile(vertices, triangles_of_cells(corners, ends, strips=False), space_of_comment(content))


def _polygons(data: bytes, at: int, count: int, fields: list[list[bytes]], order: str) -> tuple[np.ndarray, np.ndarray]:
    """Corners of one face after the other, and where each face ends among them."""
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
    return octets.view(corner)[:, 0], ends
