"""PNG pictures of grey images and masks, written uncompressed, since the log's chunks are compressed.

Every function raises a ValueError for an array of another kind, or for a PNG that is not as it is written here: so a
picture never takes more memory than its bytes in the log, and never has other pixels than other programs see.
"""

from __future__ import annotations

import struct
import zlib
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_GREY = 0
_LENGTH = struct.Struct(">I")
_STORED_HEAD = b"\x78\x01\x01"  # zlib: 32 KiB window, no dictionary; then one final stored block
_MAX_STORED = 0xFFFF


def _chunk(kind: bytes, data: bytes) -> bytes:
    return _LENGTH.pack(len(data)) + kind + data + _LENGTH.pack(zlib.crc32(data, zlib.crc32(kind)))


_END = _chunk(b"IEND", b"")


@lru_cache(maxsize=64)
def _head(height: int, width: int, bit_depth: int) -> bytes:
    return _SIGNATURE + _chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bit_depth, _GREY, 0, 0, 0))


def _encode(rows: NDArray[np.uint8], width: int, bit_depth: int) -> bytes:
    """Lay the rows out as a PNG whose zlib stream stores them as they are.

    Deflating would cost ten times as much, and chunks are compressed anyway. Even zlib's level 0 first fills tables of
    a quarter megabyte, which costs more than the picture, so a picture that fits one stored block is laid out by hand.
    """
    height, row_bytes = rows.shape
    filtered = np.zeros((height, row_bytes + 1), np.uint8)  # column 0 is the filter of each row: none
    filtered[:, 1:] = rows
    raw = filtered.tobytes()
    head = _head(height, width, bit_depth)
    size = len(raw)
    if size > _MAX_STORED:
        return head + _chunk(b"IDAT", zlib.compress(raw, 0)) + _END
    stored = _STORED_HEAD + struct.pack("<HH", size, size ^ 0xFFFF)
    block = _LENGTH.pack(len(stored) + size + 4) + b"IDAT" + stored
    adler = _LENGTH.pack(zlib.adler32(raw))
    crc = zlib.crc32(adler, zlib.crc32(raw, zlib.crc32(block[4:])))
    return b"".join((head, block, raw, adler, _LENGTH.pack(crc), _END))


def encode_image(image: NDArray[np.uint8]) -> bytes:
    """Write a grey image, (H, W) uint8, as an 8-bit PNG."""
    if image.ndim != 2 or image.dtype != np.uint8 or 0 in image.shape:
        raise ValueError(f"an image must be (H, W) uint8, got {image.shape} {image.dtype}")
    return _encode(image, image.shape[1], 8)


def encode_mask(mask: NDArray[np.bool_] | NDArray[np.uint8]) -> bytes:
    """Write a mask, (H, W) bool, or uint8 where anything but 0 is set, as a 1-bit PNG."""
    if mask.ndim != 2 or mask.dtype not in (np.uint8, np.bool_) or 0 in mask.shape:
        raise ValueError(f"a mask must be (H, W) bool or uint8, got {mask.shape} {mask.dtype}")
    return _encode(np.packbits(mask, axis=1), mask.shape[1], 1)


def decode_image(data: bytes, height: int, width: int) -> NDArray[np.uint8]:
    """Read a grey image, (H, W) uint8."""
    return _decode(data, height, width, 8)


def decode_mask(data: bytes, height: int, width: int) -> NDArray[np.bool_]:
    """Read a mask, (H, W) bool."""
    return np.unpackbits(_decode(data, height, width, 1), axis=1, count=width).view(np.bool_)


def _decode(data: bytes, height: int, width: int, bit_depth: int) -> NDArray[np.uint8]:
    """Read the rows of a picture that `_encode` wrote."""
    row_bytes = (width * bit_depth + 7) // 8
    size, head = height * (row_bytes + 1), _head(height, width, bit_depth)
    if not data.startswith(head) or len(data) < len(head) + size:
        raise ValueError(f"not a readable PNG: no {width} x {height} grey pixels of {bit_depth} bit, uncompressed")
    stream, position, kind = b"", len(head), b""
    while kind != b"IEND" and position + 12 <= len(data):
        end = position + 12 + _LENGTH.unpack_from(data, position)[0]
        kind, content = data[position + 4 : position + 8], data[position + 8 : end - 4]
        if kind not in (b"IDAT", b"IEND") or data[position:end] != _chunk(kind, content):
            raise ValueError("not a readable PNG: a part of it is damaged or of a foreign kind")
        stream, position = stream + content, end
    inflated = zlib.decompressobj()
    try:
        raw = inflated.decompress(stream, size + 1)
    except zlib.error as error:
        raise ValueError("not a readable PNG: its pixels are damaged") from error
    rows = np.frombuffer(raw, np.uint8)
    if kind != b"IEND" or position != len(data) or not inflated.eof or inflated.unused_data or len(rows) != size:
        raise ValueError("not a readable PNG: it does not end where its pixels do")
    rows = rows.reshape(height, row_bytes + 1)
    if rows[:, 0].any():
        raise ValueError("not a readable PNG: its rows are filtered")
    return rows[:, 1:].copy()
