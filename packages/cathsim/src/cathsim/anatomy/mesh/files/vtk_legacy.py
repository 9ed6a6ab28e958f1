"""Reader of VTK's legacy files (.vtk) of PolyData, in text or binary, of versions 1 to 5.1.

Source: VTK file formats, simple legacy formats, in the VTK user's guide (Kitware); cells of version 5 have a list of
offsets and one of points, as in memory.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.files.surface import Indices, SurfaceFile, numbers, space_of_comment, triangles_of_cells

_TYPES = {
    "char": "i1",
    "unsigned_char": "u1",
    "short": "i2",
    "unsigned_short": "u2",
    "int": "i4",
    "unsigned_int": "u4",
    "long": "i8",
    "unsigned_long": "u8",
    "vtkidtype": "i4",
    "float": "f4",
    "double": "f8",
    **{f"vtktype{sign}int{bits}": f"{sign or 'i'}{bits // 8}" for sign in ("", "u") for bits in (8, 16, 32, 64)},
}
_KEYWORD = re.compile(rb"^[ \t]*[A-Z_]{4,}\b", re.MULTILINE)  # what ends a block of numbers in text
_WORD = re.compile(rb"\S+")
_CELLS = (b"VERTICES", b"LINES", b"POLYGONS", b"TRIANGLE_STRIPS")
_SHOWN = 40  # characters of a line in a message


def read_legacy_vtk(content: bytes) -> SurfaceFile:
    """Reads a legacy file of PolyData; polygons are divided into triangles, strips unrolled.

    Raises:
        ValueError: it is no such file, or a damaged one.
    """
    if not content.startswith(b"# vtk DataFile Version"):
        raise ValueError("it does not begin as a VTK file")
    file = _Legacy(content)
    _, title, form = file.line(), file.line(), file.line().upper()
    if form not in (b"ASCII", b"BINARY"):
        raise ValueError("it says neither ASCII nor BINARY")
    file.text = form == b"ASCII"
    dataset = file.line().upper().split()
    if dataset[:1] != [b"DATASET"] or dataset[1:] != [b"POLYDATA"]:
        held = b" ".join(dataset)[:_SHOWN].decode(errors="replace")
        raise ValueError(f"it holds {held}, expected POLYDATA: make it by ParaView's Extract Surface")
    points, faces, space = np.zeros((0, 3)), [], space_of_comment(title)
    while words := file.line().split():
        key = words[0].upper()
        if key in (b"POINT_DATA", b"CELL_DATA"):
            break
        if key == b"POINTS":
            count, kind = file.count(words, 1), _type(words[2:])
            points = file.values(3 * count, kind).astype(np.float64).reshape(-1, 3)
        elif key in _CELLS:
            vertices, ends = file.cells(file.count(words, 1), file.count(words, 2))
            if key in _CELLS[2:]:
                faces.append(triangles_of_cells(vertices, ends, strips=key == b"TRIANGLE_STRIPS"))
        elif key == b"METADATA":
            file.skip_paragraph()
        elif key == b"FIELD":
            space = file.field(file.count(words, 2)) or space
        else:
            raise ValueError(f"it has an unknown part {words[0][:_SHOWN].decode(errors='replace')!r}")
    if not len(points) or not sum(map(len, faces)):
        raise ValueError("it holds no points or no polygons")
    return SurfaceFile(points, np.concatenate(faces), space)


def _type(words: list[bytes]) -> str:
    name = words[0].decode(errors="replace").lower() if words else ""
    if name not in _TYPES:
        raise ValueError(f"it has data of an unknown type {name[:_SHOWN]!r}")
    return _TYPES[name]


class _Legacy:
    """A place in a legacy file."""

    def __init__(self, content: bytes) -> None:
        self.content, self.at, self.text = content, 0, True

    def line(self) -> bytes:
        """The next line that is not blank; empty at the end."""
        while self.at < len(self.content):
            end = self.content.find(b"\n", self.at)
            end = len(self.content) if end < 0 else end
            line, self.at = self.content[self.at : end].strip(), end + 1
            if line:
                return line
        return b""

    def count(self, words: list[bytes], which: int) -> int:
        """One of the numbers behind a keyword, not above the bytes of the file."""
        try:
            number = int(words[which])
        except (IndexError, ValueError):
            number = -1
        if not 0 <= number <= len(self.content):
            raise ValueError(f"it has no sensible number in {b' '.join(words)[:_SHOWN].decode(errors='replace')!r}")
        return number

    def values(self, count: int, kind: str) -> NDArray:
        """The next numbers."""
        if self.text:
            match = _KEYWORD.search(self.content, self.at)
            end = match.start() if match else len(self.content)
            values = numbers(self.content[self.at : end], kind)
            self.at = end
        else:
            size = count * np.dtype(kind).itemsize
            if self.at + size > len(self.content):
                raise ValueError("it is cut off")
            values = np.frombuffer(self.content, ">" + kind, count, self.at)
            self.at += size
        if len(values) < count:
            raise ValueError("it is cut off")
        return values[:count]

    def cells(self, number: int, size: int) -> tuple[NDArray, NDArray]:
        """Points of cells one after the other, and where each ends; `size` numbers in all."""
        at = self.at
        words = self.line().split()
        if words[:1] == [b"OFFSETS"]:
            offsets = self.values(number, _type(words[1:]))
            return self.values(size, _type(self.line().split()[1:])), offsets[1:]
        self.at = at
        packed = self.values(size, "i4")
        if size == 4 * number and (packed[::4] == 3).all():
            return packed.reshape(-1, 4)[:, 1:].ravel(), 3 * np.arange(1, number + 1)
        return _unpacked(packed, number)

    def skip_paragraph(self) -> None:
        """Goes behind the next blank line."""
        end = re.compile(rb"\n[ \t\r]*\n").search(self.content, self.at - 1)
        self.at = end.end() if end else len(self.content)

    def field(self, number: int) -> str:
        """Goes behind the arrays of a field; the space among them, where 3D Slicer wrote it."""
        space = ""
        for _ in range(number):
            words = self.line().split()
            count = self.count(words, 1) * self.count(words, 2)
            if words[3:] == [b"string"]:
                texts = [self.string() for _ in range(min(count, len(self.content)))]
                if words[0] == b"SPACE" and texts[:1] in ([b"LPS"], [b"RAS"]):
                    space = texts[0].decode()
            elif self.text:
                for _ in range(min(count, len(self.content))):
                    word = _WORD.search(self.content, self.at)
                    self.at = word.end() if word else len(self.content)
            else:
                self.at += count * np.dtype(_type(words[3:])).itemsize
        return space

    def string(self) -> bytes:
        """The next text: a line, or in binary its length, in the fewest of 1, 2, 4 or 8 bytes, and its bytes."""
        if self.text:
            return self.line()
        kind = self.content[self.at : self.at + 1] or b"\xc0"
        size = (8, 4, 2, 1)[kind[0] >> 6]
        length = int.from_bytes(self.content[self.at : self.at + size], "big") & ((1 << (8 * size - 2)) - 1)
        start = self.at + size
        self.at = start + length
        return self.content[start : self.at]


def _unpacked(packed: NDArray, number: int) -> tuple[Indices, Indices]:
    """Cells that each begin with their number of points, as points one after the other and ends."""
    heads, at, values = [], 0, packed.tolist()
    for _ in range(number):
        if at >= len(values) or values[at] < 0:
            raise ValueError("its polygons do not lie within their list of points")
        heads.append(at)
        at += 1 + values[at]
    counts = packed[heads].astype(np.int64)
    return np.delete(packed[:at], heads).astype(np.int64), np.cumsum(counts)
