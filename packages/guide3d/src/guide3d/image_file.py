"""Image files by OpenCV: any usual kind read as grey levels, PNG written; what cannot be read is one sentence."""

from __future__ import annotations

import contextlib
import io
import os
import re
import tempfile
import threading
import zlib
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from guide3d.files import whole_file
from guide3d.guarded_reading import UnreadableFileError, call_in_child, open_regular
from guide3d.opencv import cv2

PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
_PNG, _JPEG, _BMP = b"\x89PNG\r\n\x1a\n", b"\xff\xd8", b"BM"
_PADDING = 1 << 24  # bytes by which tiles may be larger than their page
_DEFLATE = (8, 32946)  # numbers of this compression in a TIFF
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_NO_IMAGE = (
    "it is damaged, or no image of the kinds PNG, JPEG, TIFF and BMP; GIMP converts images, ffmpeg films to .mp4"
)
# libjpeg's words
_DAMAGE = re.compile(rb"Corrupt JPEG data|Premature end of JPEG|Inconsistent progression|Invalid SOS")
_PRINTING = threading.Lock()  # of this process's standard error
_LARGEST_PX = 16_384  # of a side; a few bytes of a file can claim more than memory holds
_SATURATED = 0.999  # share of pixels below the highest level; where fewer are, that is no level of the image
_BRIGHTEST = 2.0  # above the brightest twentieth, as a share of the range without it: more are burnt-in letters
_PEDESTAL = 0.5  # of the range: so much light is kept below the darkest pixels, where a constant is in all of them
SHOWN_WHITE = 235  # of 255, that the upper end of `shown_range` becomes
_LARGEST_FILE = 2 << 30  # bytes; TIFFs of many pages

GreyLevels = NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.float32]


class ImageError(ValueError):
    """An image is missing, damaged, or of another size than it should have."""


class _Page(NamedTuple):
    """A page of a TIFF."""

    number: int
    white_is_zero: bool
    is_misread: bool  # OpenCV refuses how its samples are laid out, or takes them for others
    packed: list[tuple[int, int]]  # first byte and bytes of what zlib has packed
    unpacked_bytes: int  # of the whole page at most


def read_grey_levels(path: str | Path) -> GreyLevels:
    """Reads a PNG, JPEG, TIFF or BMP as grey levels (h, w), 0 black.

    Colours become grey by ITU-R 601, transparency is left out, and a turn that the file asks for is not made. A TIFF
    whose white is zero is inverted; its previews and masks are left out.

    Returns:
        uint8; uint16 where it has more than 8 bits; float32 where it has real or signed numbers, or more than 16 bits.

    Raises:
        ImageError: the file is missing, damaged, cut off, no image, or a TIFF of several pages.
    """
    return _read(Path(path), colours=False)


def read_picture(path: Path) -> GreyLevels:
    """As `read_grey_levels`; (h, w, 3) uint8 red, green and blue where an image of 8 bits has colours."""
    return _read(path, colours=True)


def is_tiff(path: Path) -> bool:
    """Whether it is a TIFF, by its ending."""
    return path.suffix.lower() in (".tif", ".tiff")


def tiff_pages(path: Path, most: int | None = None) -> Generator[GreyLevels, None, tuple[int, list[str]]]:
    """Reads a TIFF page by page, as `read_picture`; at most some pages. To be called in a child process.

    Returns:
        How many pages it has, and what is to be said about them.

    Raises:
        ImageError: as there.
    """
    data = _content(path)
    if not data.startswith(_TIFF):
        raise ImageError(f"image {path} cannot be read: it is damaged, or no TIFF")
    data, pages, others = _pages(path, data)
    for page in pages[:most]:
        yield _page(path, data, page, colours=True)
    notes = [f"{path.name}: {others} pages of another size were left out"] if others else []
    return len(pages), notes


def shown_range(levels: NDArray[np.generic]) -> tuple[float, float]:
    """Levels that are shown black and nearly white of an image of more than 8 bits: those of its own content.

    Args:
        levels: (..., h, w), 0 black.
    """
    sample = np.sort(levels[..., ::4, ::4], axis=None)
    saturated = np.searchsorted(sample, sample[-1])
    if len(sample) // 2 < saturated < _SATURATED * len(sample):
        sample = sample[:saturated]
    low, dark, bright, high = (float(level) for level in np.percentile(sample, (0.1, 5, 95, 99.9)))
    high = min(high, bright + _BRIGHTEST * (bright - dark))
    if high <= low:
        low, high = float(levels.min()), float(levels.max())
    # a level of zero means no light, so it stays where it is unless it is far below all others
    return min(low, max(low - _PEDESTAL * (high - low), 0.0)), high


def is_damaged_jpeg(data: bytes) -> bool:
    """Whether its decoder misses data in the middle of a JPEG."""
    with words_printed() as words, contextlib.suppress(cv2.error):
        cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_REDUCED_GRAYSCALE_8)
    return _DAMAGE.search(words) is not None


@contextlib.contextmanager
def words_printed() -> Iterator[bytearray]:
    """Keeps what decoders print on standard error, which some tell of damage by alone; filled at the block's end."""
    words = bytearray()
    with _PRINTING, tempfile.TemporaryFile() as printed:
        former = os.dup(2)
        os.dup2(printed.fileno(), 2)
        try:
            yield words
        finally:
            os.dup2(former, 2)
            os.close(former)
            printed.seek(0)
            words += printed.read()


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


def _read(path: Path, colours: bool) -> GreyLevels:
    data = _content(path)
    if data.startswith(_TIFF):
        import tifffile  # noqa: F401 - before the child is forked, once for all

        try:
            return call_in_child(_only_page, path, data, colours, subject=f"image {path}")
        except UnreadableFileError as error:
            raise ImageError(str(error)) from None
    return _without_prints(path, data, colours)


def _content(path: Path) -> bytes:
    """A file's bytes, if nothing is wrong with it at first sight; decoders would say so in words of their own."""
    if not path.exists():
        raise ImageError(f"image {path} is missing: check its path")
    try:
        with open_regular(path, _LARGEST_FILE) as file:
            data = file.read()
    except UnreadableFileError as error:
        raise ImageError(f"image {path} cannot be read: {error}") from None
    fault = "it is empty"
    if data.startswith(_PNG):
        fault = _fault_of_png(data)
    elif data.startswith(_JPEG):
        fault = _fault_of_jpeg(data)
    elif data.startswith(_BMP):
        fault = _fault_of_bmp(data)
    elif data:
        fault = "" if data.startswith(_TIFF) else _NO_IMAGE
    if fault:
        raise ImageError(f"image {path} cannot be read: {fault}")
    return data


def _without_prints(path: Path, data: bytes, colours: bool) -> GreyLevels:
    """As `_decoded`; refuses a JPEG in whose middle the decoder misses data."""
    with words_printed() as words:
        levels = _decoded(path, data, colours)
    if data.startswith(_JPEG) and _DAMAGE.search(words):
        raise ImageError(f"image {path} cannot be read: it is damaged")
    return levels


def _decoded(path: Path, data: bytes, colours: bool, page: int = 0) -> GreyLevels:
    levels = _by_opencv(data, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH, page)
    if levels is None or levels.dtype.kind not in "uif":
        raise ImageError(f"image {path} cannot be read: it is damaged, or no image")
    if levels.dtype == np.uint8 and colours:
        picture = _by_opencv(data, cv2.IMREAD_COLOR_RGB, page)
        if picture is not None and np.ptp(picture[::4, ::4].astype(np.int16), axis=2).any():
            return picture
    if levels.dtype in (np.uint8, np.uint16):
        return levels
    if not np.isfinite(levels).all():
        raise ImageError(f"image {path} cannot be read: it holds values that are no finite numbers")
    return levels.astype(np.float32)


def _by_opencv(data: bytes, way: int, page: int) -> Any:
    try:
        images = cv2.imdecodemulti(
            np.frombuffer(data, np.uint8), way | cv2.IMREAD_IGNORE_ORIENTATION, range=(page, page + 1)
        )[1]
    except cv2.error:
        return None
    return images[0] if images else None


def _as_plain_tiff(path: Path, data: bytes, number: int) -> bytes:
    """A page of a TIFF as a TIFF that OpenCV reads: grey or colours alone, in one plane, real numbers of 32 bits."""
    import tifffile

    usual = io.BytesIO()
    try:
        with tifffile.TiffFile(io.BytesIO(data)) as file:
            page = file.pages[number].aspage()
            planes = page.asarray().reshape(page.shaped)[:, 0]
            samples = np.moveaxis(planes, 0, -1).reshape(*planes.shape[1:3], -1)
            samples = samples[..., :3] if page.photometric == 2 else samples[..., 0]
            if samples.dtype == np.float16:
                samples = samples.astype(np.float32)
            readable = page.bitspersample % 8 == 0 and (samples.ndim == 2 or samples.itemsize <= 2)
            one_plane = "contig" if samples.ndim == 3 else None
            tifffile.imwrite(usual, samples, photometric=page.photometric, planarconfig=one_plane)
    except Exception:  # a damaged file raises a dozen kinds
        readable = False
    if not readable:
        raise ImageError(
            f"image {path} cannot be read: it is damaged, or packed in a way that is not read; save it as grey levels, "
            "uncompressed"
        )
    return usual.getvalue()


def _only_page(path: Path, data: bytes, colours: bool) -> GreyLevels:
    data, pages, others = _pages(path, data)
    if len(pages) + others > 1:
        raise ImageError(
            f"image {path} holds {len(pages) + others} pages: save the one that is meant as a file of its own"
        )
    return _page(path, data, pages[0], colours)


def _pages(path: Path, data: bytes) -> tuple[bytes, list[_Page], int]:
    """The file without turns and transparency; the pages that have the first one's size; how many have another size.

    Pages that are previews or masks of others do not count.
    """
    import tifffile

    stream = io.BytesIO(data)
    try:
        with tifffile.TiffFile(stream) as file:
            all_pages = [page.aspage() for page in file.pages]
            whole = [page for page in all_pages if not (page.is_reduced or page.is_mask)] or all_pages
            for page in whole:
                # OpenCV turns a TIFF even where it is told not to, and darkens what is said to be transparent
                for tag, plain in (("Orientation", 1), ("ExtraSamples", 0)):
                    if tag in page.tags and page.tags[tag].value != plain:
                        page.tags[tag].overwrite((plain,) * page.tags[tag].count)
            sizes = [(page.imagewidth, page.imagelength) for page in whole]
            layers = max(page.imagedepth for page in whole)
            packed = [list(zip(page.dataoffsets, page.databytecounts, strict=False)) if page.compression in _DEFLATE
                      else [] for page in whole]  # fmt: skip
            pages = [_Page(page.index, page.photometric == 0, _is_misread(page), parts, page.nbytes + _PADDING)
                     for page, size, parts in zip(whole, sizes, packed, strict=True) if size == sizes[0]]  # fmt: skip
    except Exception:  # a damaged file raises a dozen kinds
        raise ImageError(f"image {path} cannot be read: it is damaged, or no image") from None
    fault = _fault_of_sides(*sizes[0])
    if layers > 1:
        fault = f"it is a volume of {layers} layers; save them as pages"
    if fault:
        raise ImageError(f"image {path} cannot be read: {fault}")
    return stream.getvalue(), pages, len(whole) - len(pages)


def _is_misread(page: Any) -> bool:
    """Whether OpenCV refuses how tifffile's page is laid out, or reads other samples than it has."""
    if page.dtype == np.float16:
        return True
    if page.samplesperpixel == 1 or page.photometric not in (0, 1, 2):  # white is zero, black is zero, RGB
        return False
    bits, planes = page.bitspersample, page.planarconfig == 2
    if page.photometric == 2:
        return bool(bits > 16 or (bits > 8 and planes))
    return bool(bits > 8 or planes or page.is_tiled)


def _is_whole(packed: bytes, most: int) -> bool:
    """Whether zlib unpacks all, with its checksum, to at most so many bytes; nothing is kept."""
    unpacking, unpacked = zlib.decompressobj(), 0
    try:
        while not unpacking.eof and packed and unpacked <= most:
            unpacked += len(unpacking.decompress(packed, 1 << 20))
            packed = unpacking.unconsumed_tail
    except zlib.error:
        return False
    return unpacking.eof


def _page(path: Path, data: bytes, page: _Page, colours: bool) -> GreyLevels:
    # OpenCV stops before the checksums
    if not all(_is_whole(data[first : first + count], page.unpacked_bytes) for first, count in page.packed):
        raise ImageError(f"image {path} cannot be read: it is damaged")
    if page.is_misread:
        levels = _decoded(path, _as_plain_tiff(path, data, page.number), colours)
    else:
        levels = _decoded(path, data, colours, page.number)
    if not page.white_is_zero or levels.dtype == np.uint8:  # of 8 bits, OpenCV has inverted it already
        return levels
    top = levels.max()  # of 12 bits in 16, 4095 is black
    if levels.dtype == np.uint16:
        return np.asarray(2 ** int(top).bit_length() - 1 - levels, np.uint16)
    return np.asarray(top - levels, np.float32)


def _fault_of_sides(width: int, height: int) -> str:
    return "" if 0 < width <= _LARGEST_PX and 0 < height <= _LARGEST_PX else f"it claims {width} x {height} px"


def _fault_of_bmp(data: bytes) -> str:
    width, height = (abs(int.from_bytes(data[at : at + 4], "little", signed=True)) for at in (18, 22))
    start, bits, compression = (int.from_bytes(data[at : at + n], "little") for at, n in ((10, 4), (28, 2), (30, 4)))
    row = (width * bits + 7) // 8
    whole = start + (height - 1) * ((row + 3) // 4 * 4) + row  # without its last row's filling, which writers leave out
    if len(data) < 34:
        return "it is cut off"
    fault = _fault_of_sides(width, height)
    return fault or ("it is cut off" if compression in (0, 3) and len(data) < whole else "")


def _fault_of_jpeg(data: bytes) -> str:
    at = 2
    while data[at : at + 1] == b"\xff" and at + 9 <= len(data):
        kind = data[at + 1]
        if kind == 0xFF:  # filling
            at += 1
        elif 0xC0 <= kind <= 0xCF and kind not in (0xC4, 0xC8, 0xCC):
            fault = _fault_of_sides(*(int.from_bytes(data[at + k : at + k + 2], "big") for k in (7, 5)))
            return fault or ("" if b"\xff\xd9" in data[-64:] else "it is cut off")
        else:
            at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return "it is cut off" if b"\xff\xd9" not in data[-64:] else "it is damaged, or no image"


def _fault_of_png(data: bytes) -> str:
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
            fault = _fault_of_sides(*(int.from_bytes(data[at + k : at + k + 4], "big") for k in (8, 12)))
            if fault:
                return fault
        at = end + 4
    return ""
