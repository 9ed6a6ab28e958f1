"""PNG pictures of grey images and masks, written uncompressed, since the log's chunks are compressed.

Every function raises a ValueError for an array of another kind, or for what is no PNG that can be read.
"""

from __future__ import annotations

import io
import struct
import zlib
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pipeline.episodes.camera import LONGEST_EDGE

_MOST_PIXELS = LONGEST_EDGE**2
# What Pillow raises for damaged pictures, by experience.
_UNREADABLE = (OSError, SyntaxError, ValueError, EOFError, struct.error, zlib.error, IndexError, KeyError, TypeError)
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
    """Write a grey image as an 8-bit PNG.

    Args:
        image: (H, W) uint8.
    """
    if image.ndim != 2 or image.dtype != np.uint8 or 0 in image.shape:
        raise ValueError(f"an image must be (H, W) uint8, got {image.shape} {image.dtype}")
    return _encode(image, image.shape[1], 8)


def encode_mask(mask: NDArray[np.bool_] | NDArray[np.uint8]) -> bytes:
    """Write a mask as a 1-bit PNG.

    Args:
        mask: (H, W) bool, or uint8 where anything but 0 is set.
    """
    if mask.ndim != 2 or mask.dtype not in (np.uint8, np.bool_) or 0 in mask.shape:
        raise ValueError(f"a mask must be (H, W) bool or uint8, got {mask.shape} {mask.dtype}")
    return _encode(np.packbits(mask, axis=1), mask.shape[1], 1)


def decode_image(data: bytes) -> NDArray[np.uint8]:
    """Read a grey PNG, (H, W) uint8."""
    return np.array(_open(data).convert("L"), dtype=np.uint8)


def decode_mask(data: bytes) -> NDArray[np.bool_]:
    """Read a mask, (H, W) bool."""
    return np.array(_open(data).convert("L"), dtype=np.uint8) > 0


def _open(data: bytes) -> Image.Image:
    try:
        picture = Image.open(io.BytesIO(data), formats=("PNG",))
        if picture.width * picture.height > _MOST_PIXELS:
            raise ValueError(f"it has {picture.width} x {picture.height} pixels, at most {_MOST_PIXELS} are read")
        picture.load()
    except (*_UNREADABLE, Image.DecompressionBombError) as error:
        raise ValueError(f"not a readable PNG: {error}") from error
    return picture
