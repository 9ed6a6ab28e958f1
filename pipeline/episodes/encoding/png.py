"""PNG pictures of grey images and masks, written uncompressed, since the log's chunks are compressed.

Every function raises a ValueError for an array of another kind, or for a PNG that is not as it is written here: so a
picture never takes more memory than its bytes in the log.
"""

from __future__ import annotations

import struct
import zlib
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

_END = b"\0\0\0\0IEND\xaeB`\x82"


@lru_cache(maxsize=64)
def _head(height: int, width: int, bit_depth: int) -> bytes:
    """Signature and header of a grey picture."""
    header = b"IHDR" + struct.pack(">IIBBBBB", width, height, bit_depth, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", len(header) - 4) + header + struct.pack(">I", zlib.crc32(header))


def _encode(picture: NDArray[np.uint8], *, bilevel: bool = False) -> bytes:
    """Stores the pixels as they are: deflating would cost ten times as much, and chunks are compressed anyway."""
    from guide3d.opencv import cv2

    options = {
        cv2.IMWRITE_PNG_COMPRESSION: 0,
        cv2.IMWRITE_PNG_FILTER: cv2.IMWRITE_PNG_FILTER_NONE,
        cv2.IMWRITE_PNG_BILEVEL: int(bilevel),
    }
    return bytes(cv2.imencode(".png", picture, [value for pair in options.items() for value in pair])[1])


def encode_image(image: NDArray[np.uint8]) -> bytes:
    """Write a grey image, (H, W) uint8, as an 8-bit PNG."""
    if image.ndim != 2 or image.dtype != np.uint8 or 0 in image.shape:
        raise ValueError(f"an image must be (H, W) uint8, got {image.shape} {image.dtype}")
    return _encode(image)


def encode_mask(mask: NDArray[np.bool_] | NDArray[np.uint8]) -> bytes:
    """Write a mask, (H, W) bool, or uint8 where anything but 0 is set, as a 1-bit PNG."""
    if mask.ndim != 2 or mask.dtype not in (np.uint8, np.bool_) or 0 in mask.shape:
        raise ValueError(f"a mask must be (H, W) bool or uint8, got {mask.shape} {mask.dtype}")
    return _encode(mask.view(np.uint8), bilevel=True)


def decode_image(data: bytes, height: int, width: int) -> NDArray[np.uint8]:
    """Read a grey image, (H, W) uint8."""
    return _decode(data, height, width, 8)


def decode_mask(data: bytes, height: int, width: int) -> NDArray[np.bool_]:
    """Read a mask, (H, W) bool."""
    return _decode(data, height, width, 1) > 0


def _decode(data: bytes, height: int, width: int, bit_depth: int) -> NDArray[np.uint8]:
    from guide3d.opencv import cv2

    head, size = _head(height, width, bit_depth), height * ((width * bit_depth + 7) // 8 + 1)
    if not data.startswith(head) or len(data) < len(head) + size:
        raise ValueError(f"not a readable PNG: no {width} x {height} grey pixels of {bit_depth} bit, uncompressed")
    ends = data.find(_END) + len(_END) == len(data)
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if ends else None
    if picture is None or picture.shape != (height, width) or picture.dtype != np.uint8:
        raise ValueError("not a readable PNG: a part of it is damaged or of a foreign kind")
    return np.asarray(picture)
