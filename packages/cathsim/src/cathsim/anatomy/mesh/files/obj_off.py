"""Reader of Wavefront OBJ: vertices, and polygons of them, in lines of text.

Source: Object files (.obj), appendix B1 of the manual of Wavefront's Advanced Visualizer. trimesh (5.2) counts relative
indices from the end of the file, and reads no tabs, indented lines or comments behind values.
"""

from __future__ import annotations

import codecs
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


def _part(vertices: Array, faces: Indices, space: str) -> SurfaceFile:
    """Some of the faces, with the vertices from their first to their last."""
    first = max(faces.min(), 0)  # an index that is not in the file stays so
    return SurfaceFile(vertices[first : faces.max() + 1], faces - first, space)


def _lines(content: bytes) -> Iterable[str]:
    """Lines of a text, whatever ends them, without a byte-order mark."""
    wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    return TextIOWrapper(BytesIO(content), "utf-16" if wide else "utf-8-sig", errors="replace")
