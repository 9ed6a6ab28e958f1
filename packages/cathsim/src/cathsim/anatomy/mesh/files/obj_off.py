"""Readers of OBJ and OFF: vertices, and polygons of them, in lines of text.

Sources: Object files (.obj), appendix B1 of the manual of Wavefront's Advanced Visualizer; OFF files, in the manual of
Geomview. trimesh (5.2) counts an OBJ's relative indices from the end of the file, reads no tabs, indented lines or
comments behind values there, and no mixed polygons of more than four corners in OFF.
"""

from __future__ import annotations

import codecs
import re
from array import array
from collections import defaultdict
from collections.abc import Iterable
from io import BytesIO, TextIOWrapper

import numpy as np

from cathsim.anatomy.mesh.files.surface import (
    Array,
    Indices,
    SurfaceFile,
    part_names,
    rows_beyond,
    space_of_comment,
    triangles_of_cells,
)


def read_obj(content: bytes) -> list[tuple[str, SurfaceFile]]:
    """Reads vertices and faces without materials, polygons as fans; objects or groups with names of vessels apart.

    Raises:
        Exception: a vertex or a face is not of numbers.
    """
    points, corners, ends, before = array("d"), array("q"), array("q"), array("q")
    begun: dict[str, list[tuple[int, str]]] = {"o": [], "g": []}  # number of faces before each, and its name
    for line in _lines(content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")):
        key, *words = line.partition("#")[0].split() or [""]
        if key == "v":
            x, y, z = map(float, words[:3])
            points.extend((x, y, z))
        elif key == "f":
            corners.extend([int(word.partition("/")[0]) for word in words])
            ends.append(len(corners))
            before.append(len(points) // 3)
        elif key in begun:
            begun[key].append((len(ends), line.strip()[1:].strip() or "default"))
    vertices, indices, sizes = np.array(points).reshape(-1, 3), np.array(corners), np.diff(ends, prepend=0)
    indices += np.where(indices < 0, np.repeat(before, sizes), -1)
    faces, space = triangles_of_cells(indices, np.array(ends), strips=False), space_of_comment(content)
    notes: tuple[str, ...] = ()
    for parts in begun.values():
        names, note = part_names(name.encode() for _, name in parts)
        notes += (note,) if note else ()
        if names:
            triangles = np.concatenate([[0], np.cumsum(np.maximum(sizes - 2, 0))])
            runs = np.split(faces, triangles[[face for face, _ in parts]])
            named: dict[str, list[np.ndarray]] = defaultdict(list)
            for name, run in zip(["default", *(name for _, name in parts)], runs, strict=True):
                if len(run):
                    named[name].append(run)
            return [(name, _part(vertices, np.concatenate(runs), space)) for name, runs in named.items()]
    return [("", SurfaceFile(vertices, faces, space, notes))]


def read_off(content: bytes) -> SurfaceFile:
    """Reads vertices and faces of text, polygons as fans, without colours and normals.

    Raises:
        Exception: it is no such file, or holds less than it promises.
    """
    rows = [row for line in _lines(content) if (row := line.partition("#")[0].strip())]
    head = re.match(r"(?:[A-Z]*OFF)?\s*(\d+)\s+(\d+)", "\n".join(rows[:2]))
    if head is None:
        raise ValueError("it does not begin as an OFF file")
    rows, count, polygons = rows[head.group().count("\n") + 1 :], int(head[1]), int(head[2])
    notes = rows_beyond(count + polygons, len(rows))
    points, corners, sizes = array("d"), array("q"), array("q")
    for row in rows[:count]:
        x, y, z = map(float, row.split()[:3])
        points.extend((x, y, z))
    for row in rows[count : count + polygons]:
        words = row.split()
        sizes.append(int(words[0]))
        corners.extend(map(int, words[1 : 1 + sizes[-1]]))
    faces = triangles_of_cells(np.array(corners), np.cumsum(sizes), strips=False)
    return SurfaceFile(np.array(points).reshape(-1, 3), faces, space_of_comment(content), notes)


def _part(vertices: Array, faces: Indices, space: str) -> SurfaceFile:
    """Some of the faces, with the vertices from their first to their last."""
    first = max(faces.min(), 0)  # an index that is not in the file stays so
    return SurfaceFile(vertices[first : faces.max() + 1], faces - first, space)


def _lines(content: bytes) -> Iterable[str]:
    """Lines of a text, whatever ends them, without a byte-order mark."""
    wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    return TextIOWrapper(BytesIO(content), "utf-16" if wide else "utf-8-sig", errors="replace")
