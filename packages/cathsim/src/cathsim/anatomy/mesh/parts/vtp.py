"""Reader of VTK XML PolyData (.vtp): points and polygons, in text, base64 or appended data, compressed by zlib or not.

Source: VTK file formats, XML formats, in the VTK user's guide (Kitware).
"""

from __future__ import annotations

import base64
import re
import xml.etree.ElementTree as ElementTree
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

_TYPES = {
    "Float32": "f4",
    "Float64": "f8",
    **{f"{sign}Int{bits}": f"{kind}{bits // 8}" for sign, kind in (("", "i"), ("U", "u")) for bits in (8, 16, 32, 64)},
}
_APPENDED = re.compile(rb"<AppendedData[^>]*>\s*_", re.DOTALL)


@dataclass(frozen=True)
class _Encoding:
    order: str  # of bytes, "<" or ">"
    header: str  # type of a block's header
    compressed: bool
    appended: bytes
    raw: bool  # whether the appended data is raw, not base64


def read_vtp(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Reads points (n, 3) and triangles (m, 3) of a .vtp file; polygons are divided into triangles, strips unrolled.

    Raises:
        ValueError: it is no such file, or one that is damaged or compressed otherwise than by zlib.
    """
    content = path.read_bytes()
    appended, raw = b"", True
    if found := _APPENDED.search(content):
        raw = b'encoding="base64"' not in found.group()
        end = content.rfind(b"</AppendedData>")
        appended = content[found.end() : end]
        content = content[: found.end()] + content[end:]
    try:
        root = ElementTree.fromstring(content)
    except ElementTree.ParseError as error:
        raise ValueError(f"it is no XML ({error})") from error
    if root.tag != "VTKFile" or root.get("type") != "PolyData":
        raise ValueError(f"it holds {root.get('type') or root.tag}, expected VTK PolyData")
    compressor = root.get("compressor", "")
    if compressor not in ("", "vtkZLibDataCompressor"):
        raise ValueError(f"it is compressed by {compressor}, expected vtkZLibDataCompressor or none")
    order = ">" if root.get("byte_order") == "BigEndian" else "<"
    header = order + _TYPES.get(root.get("header_type", "UInt32"), "u4")
    encoding = _Encoding(order, header, bool(compressor), appended, raw)
    points, faces, before = [], [], 0
    for piece in root.iter("Piece"):
        place = piece.find("Points/DataArray")
        if place is None:
            continue
        own = _values(place, encoding).astype(np.float64).reshape(-1, 3)
        points.append(own)
        for tag, divide in (("Polys", _fans), ("Strips", _strips)):
            arrays = {array.get("Name"): array for array in piece.findall(f"{tag}/DataArray")}
            if {"connectivity", "offsets"} <= set(arrays):
                vertices, ends = (_values(arrays[k], encoding).astype(np.int64) for k in ("connectivity", "offsets"))
                faces.append(divide(vertices, ends) + before)
        before += len(own)
    if not points or not faces:
        raise ValueError("it holds no points or no polygons")
    return np.concatenate(points), np.concatenate(faces)


def _values(array: ElementTree.Element, encoding: _Encoding) -> NDArray:
    kind = _TYPES.get(array.get("type", ""))
    if kind is None:
        raise ValueError(f"it has data of an unknown type {array.get('type')!r}")
    layout = array.get("format", "ascii")
    if layout == "ascii":
        return np.array((array.text or "").split(), dtype=kind)
    if layout == "appended":
        start = int(array.get("offset", "0"))
        data = encoding.appended[start:]
        return np.frombuffer(_block(data, encoding, encoding.raw), encoding.order + kind)
    return np.frombuffer(_block((array.text or "").strip().encode(), encoding, False), encoding.order + kind)


def _block(data: bytes, encoding: _Encoding, raw: bool) -> bytes:
    """The bytes of one array behind its header."""
    size = np.dtype(encoding.header).itemsize

    def taken(start: int, count: int) -> bytes:
        return data[start : start + count] if raw else b""

    if not encoding.compressed:
        if raw:
            (count,) = np.frombuffer(taken(0, size), encoding.header)
            return taken(size, int(count))
        whole = _decoded(data)
        (count,) = np.frombuffer(whole[:size], encoding.header)
        return whole[size : size + int(count)]
    if raw:
        (number,) = np.frombuffer(taken(0, size), encoding.header)
        header = np.frombuffer(taken(0, size * (3 + int(number))), encoding.header)
        body = data[size * (3 + int(number)) :]
    else:  # the header is encoded by itself
        (number,) = np.frombuffer(base64.b64decode(data[: _encoded(size)])[:size], encoding.header)
        length = _encoded(size * (3 + int(number)))
        header = np.frombuffer(base64.b64decode(data[:length]), encoding.header)
        body = base64.b64decode(data[length : length + _encoded(int(header[3:].sum()))])
    blocks, start = [], 0
    for count in header[3:].tolist():
        blocks.append(zlib.decompress(body[start : start + count]))
        start += count
    return b"".join(blocks)


def _encoded(count: int) -> int:
    """Characters of base64 for so many bytes."""
    return 4 * -(-count // 3)


def _decoded(data: bytes) -> bytes:
    """Base64 up to its padding: the appended arrays follow each other."""
    end = data.find(b"=")
    stop = len(data) if end < 0 else end + (2 if data[end : end + 2] == b"==" else 1)
    part = data[:stop]
    return base64.b64decode(part[: len(part) - len(part) % 4])


def _fans(vertices: NDArray[np.int64], ends: NDArray[np.int64]) -> NDArray[np.int64]:
    starts = np.concatenate([[0], ends[:-1]])
    counts = ends - starts
    faces = []
    for count in np.unique(counts[counts >= 3]):
        polygon = vertices[starts[counts == count][:, None] + np.arange(count)]
        faces += [polygon[:, [0, k, k + 1]] for k in range(1, count - 1)]
    return np.concatenate(faces) if faces else np.zeros((0, 3), np.int64)


def _strips(vertices: NDArray[np.int64], ends: NDArray[np.int64]) -> NDArray[np.int64]:
    starts = np.concatenate([[0], ends[:-1]])
    faces = [vertices[k : k + 3] for a, b in zip(starts, ends, strict=True) for k in range(a, b - 2)]
    return np.array(faces, np.int64).reshape(-1, 3)
