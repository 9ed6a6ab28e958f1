"""Reader of VTK XML PolyData (.vtp): points, polygons and strips, in text, base64 or appended data, compressed or not.

Source: VTK file formats, XML formats, in the VTK user's guide (Kitware). Neither meshio (5.3.5, 0 of 396 files that VTK
wrote in all its ways) nor trimesh reads PolyData, and VTK itself is a download of 140 MB.
"""

from __future__ import annotations

import base64
import lzma
import re
import xml.etree.ElementTree as ElementTree
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.files.surface import MOST_TRIANGLES, SurfaceFile, numbers, triangles_of_cells

_TYPES = {
    "Float32": "f4",
    "Float64": "f8",
    "String": "u1",
    **{f"{sign}Int{bits}": f"{kind}{bits // 8}" for sign, kind in (("", "i"), ("U", "u")) for bits in (8, 16, 32, 64)},
}
_APPENDED = re.compile(rb"<AppendedData[^>]*>\s*_")
_MOST = 3 * 24 * MOST_TRIANGLES  # bytes of an array: three points of their own for every triangle
_CUT = "an array of it is cut off"


@dataclass(frozen=True)
class _Encoding:
    order: str  # of bytes, "<" or ">"
    header: np.dtype  # of a block's header
    unpack: Callable[[bytes, int], bytes] | None  # one block, at most so many bytes
    appended: bytes
    raw: bool  # whether the appended data is raw, not base64


def read_vtp(content: bytes) -> SurfaceFile:
    """Reads a .vtp file; polygons are divided into triangles, strips unrolled.

    Raises:
        ValueError: it is no such file, or a damaged one, or needs a module that is not installed.
    """
    appended, raw = b"", True
    if match := _APPENDED.search(content):
        raw = b'encoding="base64"' not in match.group()
        end = content.rfind(b"</AppendedData>")
        if end < match.end():
            raise ValueError("its appended data is cut off")
        appended = content[match.end() : end]
        content = content[: match.end()] + content[end:]
    try:
        root = ElementTree.fromstring(content)
    except ElementTree.ParseError as error:
        raise ValueError(f"it is no XML ({error})") from error
    if root.tag != "VTKFile" or root.get("type") != "PolyData":
        raise ValueError(f"it holds {root.get('type') or root.tag}, expected VTK PolyData")
    order = ">" if root.get("byte_order") == "BigEndian" else "<"
    header = np.dtype(order + _TYPES.get(root.get("header_type", "UInt32"), "u4"))
    encoding = _Encoding(order, header, _unpacker(root.get("compressor", "")), appended, raw)
    points, faces, before = [], [], 0
    for piece in root.iter("Piece"):
        place = piece.find("Points/DataArray")
        if place is None:
            continue
        own = _values(place, encoding).astype(np.float64).reshape(-1, 3)
        if len(own) != int(piece.get("NumberOfPoints", len(own))):
            raise ValueError(_CUT)
        points.append(own)
        for tag in ("Polys", "Strips"):
            arrays = {array.get("Name"): array for array in piece.findall(f"{tag}/DataArray")}
            if {"connectivity", "offsets"} <= set(arrays):
                vertices, ends = (_values(arrays[name], encoding) for name in ("connectivity", "offsets"))
                if len(ends) != int(piece.get(f"NumberOf{tag}", len(ends))):
                    raise ValueError(_CUT)
                own_faces = triangles_of_cells(vertices, ends, strips=tag == "Strips")
                if len(own_faces) and not 0 <= own_faces.min() <= own_faces.max() < len(own):
                    raise ValueError("it has faces of points that it does not have")
                faces.append(own_faces + before)
        before += len(own)
    if not points or not sum(map(len, faces)):
        raise ValueError("it holds no points or no polygons")
    return SurfaceFile(np.concatenate(points), np.concatenate(faces), _space(root, encoding))


def _space(root: ElementTree.Element, encoding: _Encoding) -> str:
    """The space that 3D Slicer writes as a text among the field's data."""
    for array in root.iter("Array"):
        if array.get("Name") == "SPACE" and array.get("type") == "String":
            text = _values(array, encoding).tobytes().split(b"\0")[0]
            return text.decode() if text in (b"LPS", b"RAS") else ""
    return ""


def _unpacker(compressor: str) -> Callable[[bytes, int], bytes] | None:
    if compressor == "":
        return None
    if compressor == "vtkZLibDataCompressor":
        return lambda data, size: _unpacked(zlib.decompressobj(), data, size)
    if compressor == "vtkLZMADataCompressor":
        return lambda data, size: _unpacked(lzma.LZMADecompressor(), data, size)
    if compressor == "vtkLZ4DataCompressor":
        try:
            import lz4.block  # type: ignore[import-untyped]
        except ModuleNotFoundError as error:
            what = "it is compressed by LZ4: pip install 'endonav-cathsim[surfaces]', or write it with zlib"
            raise ValueError(what) from error
        return lambda data, size: lz4.block.decompress(data, uncompressed_size=size)
    raise ValueError(f"it is compressed by {compressor}, expected zlib, LZMA, LZ4 or none")


def _unpacked(stream: Any, data: bytes, size: int) -> bytes:
    """One block of at most so many bytes and one; empty where its end, with the checksum, is not reached."""
    block: bytes = stream.decompress(data, size + 1)
    return block if stream.eof else b""


def _values(array: ElementTree.Element, encoding: _Encoding) -> NDArray:
    kind = _TYPES.get(array.get("type", ""))
    if kind is None:
        raise ValueError(f"it has data of an unknown type {array.get('type')!r}")
    layout = array.get("format", "ascii")
    if layout == "ascii":
        return numbers(array.text or "", kind)
    if layout == "appended":
        start = int(array.get("offset", "0"))
        if not 0 <= start < max(len(encoding.appended), 1):
            raise ValueError(_CUT)
        data = _Data(encoding.appended, start, encoding.raw)
    else:
        data = _Data((array.text or "").strip().encode(), 0, False)
    return np.frombuffer(_block(data, encoding), encoding.order + kind)


@dataclass
class _Data:
    """Bytes at a place of a file, as they are or in base64."""

    content: bytes
    at: int
    raw: bool

    def taken(self, count: int) -> bytes:
        """The next bytes; what base64 encoded together is taken together.

        Raises:
            ValueError: there are less, or more than an array may have.
        """
        length = count if self.raw else 4 * -(-count // 3)
        if not 0 <= count <= _MOST or self.at + length > len(self.content):
            raise ValueError(_CUT)
        part = self.content[self.at : self.at + length]
        self.at += length
        return part if self.raw else base64.b64decode(part)[:count]

    def peeked(self, count: int) -> bytes:
        """The next bytes, which stay the next."""
        at = self.at
        part = self.taken(count)
        self.at = at
        return part


def _block(data: _Data, encoding: _Encoding) -> bytes:
    """The bytes of one array behind its header."""
    kind = encoding.header
    number = int(np.frombuffer(data.peeked(kind.itemsize), kind)[0]) if data.content else 0
    if encoding.unpack is None:  # the number of bytes, encoded together with them
        return data.taken(kind.itemsize + number)[kind.itemsize :] if data.content else b""
    if number == 0:
        return b""
    # number of blocks, bytes of each, of the last one if it is shorter, of each when compressed: encoded by themselves
    _, size, last, *packed = np.frombuffer(data.taken(kind.itemsize * (3 + number)), kind).tolist()
    sizes = [size] * (number - 1) + [last or size]
    if sum(sizes) > _MOST:
        raise ValueError(f"it has an array of {sum(sizes) / 1e9:.3g} GB, at most {_MOST / 1e9:.3g} GB are read")
    body, blocks, at = data.taken(sum(packed)), [], 0
    for count, full in zip(packed, sizes, strict=True):
        block = encoding.unpack(body[at : at + count], full)
        if len(block) != full:
            raise ValueError(_CUT)
        blocks.append(block)
        at += count
    return b"".join(blocks)
