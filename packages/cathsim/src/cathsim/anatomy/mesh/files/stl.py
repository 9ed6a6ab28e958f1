"""Reader of STL, binary and text; what its length says is weighed against the number of triangles that it promises."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from cathsim.anatomy.mesh.files.surface import MOST_TRIANGLES, SurfaceFile, numbers, part_names, space_of_comment
from cathsim.anatomy.vessel_names import is_other

_HEAD = 84  # bytes: a comment of 80, and the number of triangles
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", 9), ("attribute", "<u2")])
_SOLID = re.compile(rb"^[ \t]*solid\b", re.IGNORECASE | re.MULTILINE)
_VERTEX = re.compile(rb"\bvertex\b([^\n\r]*)", re.IGNORECASE)


def read_stl(content: bytes) -> list[tuple[str, SurfaceFile]]:
    """Reads an STL file: in text its solids by name where several have names of vessels, else as one of no name.

    A file with a whole number of triangles that is not the promised one is read with a note, and so is one with other
    bytes behind the promised triangles.

    Raises:
        ValueError: it is no such file, or it is cut off.
    """
    size, promised = len(content) - _HEAD, int.from_bytes(content[80:_HEAD], "little")
    exact = size == promised * _TRIANGLE.itemsize
    if not exact and content[:_HEAD].lstrip().lower().startswith(b"solid") and b"\0" not in content[:_HEAD]:
        return _solids(content)
    if size < 0:
        raise ValueError("it is shorter than the header of a binary STL file")
    whole_triangles, rest = divmod(size, _TRIANGLE.itemsize)
    notes: tuple[str, ...] = ()
    count = whole_triangles if rest == 0 else promised
    if count > whole_triangles and b"\0" not in content[:_HEAD]:  # a count below 16 million has one
        raise ValueError("it begins as no STL file, binary or text")
    if count > whole_triangles:
        raise ValueError(f"it is cut off: it promises {promised} triangles and holds {whole_triangles}")
    if count > MOST_TRIANGLES:
        raise ValueError(f"it has {count} triangles, at most {MOST_TRIANGLES} are read")
    if rest:
        notes = (f"{size - promised * _TRIANGLE.itemsize} bytes behind its {promised} triangles are left out",)
    elif count != promised:
        notes = (f"its header promises {promised} triangles, it holds {count}: all of them are read",)
    triangles = np.frombuffer(content, _TRIANGLE, count, _HEAD)
    vertices = triangles["corners"].astype(np.float64).reshape(-1, 3)
    faces = np.arange(3 * count).reshape(-1, 3)
    return [("", SurfaceFile(vertices, faces, space_of_comment(content[:80]), notes))]


def _solids(content: bytes) -> list[tuple[str, SurfaceFile]]:
    solids = _SOLID.split(content)[1:]
    titles = [solid.partition(b"\n")[0] for solid in solids]
    names, note = part_names(titles)
    if len(names) > 1:  # a single solid's title is often a comment
        space = space_of_comment(titles[0])
        parts = [
            (title.decode(errors="replace").strip(), _read_text(solid))
            for title, solid in zip(titles, solids, strict=True)
        ]
        return [(name, replace(part, space=space)) for name, part in parts if len(part.faces)]
    if names and is_other(names[0]):
        note = f"it is called {names[0][:60]}, which is no artery's name"
    whole = _read_text(content)
    return [("", replace(whole, notes=(note,) if note else ()))]


def _read_text(content: bytes) -> SurfaceFile:
    begun, ended = (len(re.findall(word, content, re.IGNORECASE)) for word in (rb"\bfacet\b", rb"\bendfacet\b"))
    vertices = numbers(b" ".join(_VERTEX.findall(content)), "f8")
    if begun != ended or len(vertices) != 9 * begun or b"endsolid" not in content[-1_000:].lower():
        raise ValueError(f"it is cut off or damaged: {begun} of its triangles begin, {len(vertices) // 9} are whole")
    faces = np.arange(3 * begun).reshape(-1, 3)
    return SurfaceFile(vertices.reshape(-1, 3), faces, space_of_comment(content.splitlines()[0]))
