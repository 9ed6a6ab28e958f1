"""Image files by OpenCV: any usual kind read as grey levels, PNG written; what cannot be read is one sentence."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from guide3d.atomic_file import whole_file
from guide3d.opencv import cv2

PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
_PNG, _JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
_LARGEST_PX = 32_768  # of a side; a few bytes of a PNG can claim more than memory holds

GreyLevels = NDArray[np.uint8] | NDArray[np.uint16]


class ImageError(ValueError):
    """An image is missing, damaged, or of another size than it should have."""


def read_grey_levels(path: str | Path) -> GreyLevels:
    """Reads a PNG, JPEG, TIFF or BMP as grey levels (h, w), uint8, or uint16 where it has more than 8 bits.

    Colours become grey by ITU-R 601, transparency is left out, and a turn that the file asks for is not made.

    Raises:
        ImageError: the file is missing, damaged, cut off, or no image.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise ImageError(f"image {path} is missing") from None
    except OSError as error:
        raise ImageError(f"image {path} cannot be read: {error.strerror}") from None
    fault = _fault(data)
    if fault is None:
        grey = None
        try:
            way = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
            grey = cv2.imdecode(np.frombuffer(data, np.uint8), way)
        except cv2.error:
            pass
        if grey is not None and grey.dtype in (np.uint8, np.uint16):
            return grey  # type: ignore[return-value]
        fault = "it is damaged, or no image"
    raise ImageError(f"image {path} cannot be read: {fault}")


def eight_bits(levels: GreyLevels) -> NDArray[np.uint8]:
    """Grey levels as uint8: deeper ones by their upper eight bits."""
    return levels.astype(np.uint8) if levels.dtype == np.uint8 else (levels >> 8).astype(np.uint8)


def encode_png(image: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """A PNG of an image (h, w) or, in red, green and blue, (h, w, 3)."""
    _, data = cv2.imencode(".png", image if image.ndim == 2 else image[..., ::-1])
    return data.tobytes()


def write_image(image: NDArray[Any], path: str | Path) -> None:
    """Writes an image (h, w) of the kind that the path's ending says, PNG without one; whole or not at all.

    Raises:
        ImageError: no such kind of image.
    """
    ending = Path(path).suffix or ".png"
    try:
        _, data = cv2.imencode(ending, image)
    except cv2.error:
        raise ImageError(f"image {path} cannot be written: {ending} is no kind of image") from None
    with whole_file(path) as file:
        file.write(data.tobytes())


def write_png(image: NDArray[np.uint8] | NDArray[np.uint16], path: str | Path) -> None:
    """Writes an image (h, w) or (h, w, 3) RGB; the file appears whole or not at all."""
    with whole_file(path) as file:
        file.write(encode_png(image))


def _fault(data: bytes) -> str | None:
    """What is wrong with a file at first sight; decoders would print it in words of their own, or read on."""
    if not data:
        return "it is empty"
    if data.startswith(_PNG):
        return _fault_of_png(data)
    if data.startswith(_JPEG) and b"\xff\xd9" not in data[-64:]:
        return "it is cut off"
    return None


def _fault_of_png(data: bytes) -> str | None:
    at, kind = len(_PNG), b""
    while kind != b"IEND":
        if at + 12 > len(data):
            return "it is cut off"
        length, kind = int.from_bytes(data[at : at + 4], "big"), data[at + 4 : at + 8]
        end = at + 8 + length
        if end + 4 > len(data):
            return "it is cut off"
        if zlib.crc32(data[at + 4 : end]) != int.from_bytes(data[end : end + 4], "big"):
            return "it is damaged"
        if kind == b"IHDR":
            sides = int.from_bytes(data[at + 8 : at + 12], "big"), int.from_bytes(data[at + 12 : at + 16], "big")
            if not all(0 < side <= _LARGEST_PX for side in sides):
                return f"it claims {sides[0]} x {sides[1]} px"
        at = end + 4
    return None
