"""The pixels of an X-ray file: decoded, as stored, and as grey values by the file's own window or table."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from guide3d.dicom.header import Header, silent
from guide3d.image_file import SHOWN_WHITE, is_damaged_jpeg, shown_range

_LARGEST_PX = 8192  # of a side, as cameras have it
_SOME = 8  # frames, by whose content a run without a window is shown
_JPEG = "1.2.840.10008.1.2.4."  # and two digits; with three it is a film
_STARTS = (b"\xff\xd8\xff", b"\xff\x4f\xff")  # of a JPEG and a JPEG 2000
_JPEG_LOSSLESS = ("1.2.840.10008.1.2.4.57", "1.2.840.10008.1.2.4.70")


def stored_frames(header: Header) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Decodes all frames: (n, h, w) as stored, uint8 or uint16.

    Raises:
        ValueError: there are none, they are coloured or signed, cut off, or compressed in a way for which no decoder is
            installed.
    """
    _check_layout(header)
    if "PixelData" not in header.dataset:
        raise ValueError(f"{header.path}: expected pictures, found a DICOM file without pixel data")
    with silent():
        try:
            syntax = header.dataset.file_meta.TransferSyntaxUID
            compressed = bool(syntax.is_encapsulated)
        except Exception:
            raise header.damaged() from None
        if compressed:
            _check_decoder(header, syntax)
            if str(syntax).startswith(_JPEG) and len(syntax) == len(_JPEG) + 2:
                _check_jpeg(header)
        else:
            _check_length(header)
        try:
            # unused bits are removed below, where plain pixels are copied
            header.dataset.pixel_array_options(view_only=True, correct_unused_bits=False)
            pixels = np.asarray(header.dataset.pixel_array)
        except MemoryError:
            raise
        except Exception:  # pydicom's message may quote the file
            if compressed:
                raise ValueError(f"{header.path}: the compressed pictures are damaged or cut off") from None
            raise header.damaged() from None
    size = int(header.number("Rows")), int(header.number("Columns"))
    frames = pixels.reshape(-1, *pixels.shape[-2:])
    if frames.shape != (frame_count(header), *size):
        raise ValueError(
            f"{header.path}: expected {frame_count(header)} frames of {size[1]} x {size[0]} px, "
            f"found {len(frames)} of {frames.shape[2]} x {frames.shape[1]} px"
        )
    # bits above the stored ones may hold overlays of old systems
    return np.asarray(frames & frames.dtype.type(2 ** stored_bits(header) - 1))


def frame_count(header: Header) -> int:
    """How many frames the file says to hold."""
    count = header.number("NumberOfFrames")
    return 1 if np.isnan(count) else int(count)


def stored_bits(header: Header) -> int:
    """How many bits of each pixel count."""
    return int(header.number("BitsStored"))


def grey_tables(header: Header, frames: NDArray[np.generic]) -> tuple[NDArray[np.uint8], str]:
    """Makes the tables from stored to grey values, 0 black: (1, levels), or (n, levels) where frames differ.

    The value-of-interest table goes before the window. Without both, stored values of 8 bits are shown as they are,
    deeper ones by what the frames (n, h, w) hold; the text returned says so, else it is empty. A modality table is not
    applied: of X-ray runs it says how grey values belong to light, not how to show them.

    Source:
        DICOM PS3.3, C.11.2.1.1 (tables), C.11.2.1.2 and C.11.2.1.3 (windows).
    """
    levels = np.arange(2 ** stored_bits(header), dtype=float)
    inverse = header.word("PhotometricInterpretation") == "MONOCHROME1"
    inverse |= header.word("PresentationLUTShape") == "INVERSE"
    tables, own, note = [], None, ""
    for frame in range(len(frames) if header.kind.startswith("enhanced") else 1):
        brightness = _brightness(header, frame, levels)
        if brightness is not None:
            bright = 1 - brightness if inverse else brightness
        else:
            own, note = (own, note) if own is not None else _by_content(levels[::-1] if inverse else levels, frames)
            bright = own
        tables.append(np.rint(255 * np.clip(bright, 0.0, 1.0)).astype(np.uint8))
    if all((table == tables[0]).all() for table in tables):
        tables = tables[:1]
    return np.stack(tables), note


def _by_content(light: np.ndarray, frames: NDArray[np.generic]) -> tuple[np.ndarray, str]:
    """Brightness (levels,) by what frames hold of the light (levels,) of stored values, and what to say of it."""
    if len(light) <= 256:
        return light / (len(light) - 1), ""
    low, high = shown_range(light[frames[:: 1 + len(frames) // _SOME]])
    note = f"it has no window: grey values of {low:g} to {high:g} are shown"
    return (light - low) * (SHOWN_WHITE / 255 / max(high - low, 1.0)), note


def has_empty_window(header: Header, frame: int) -> bool:
    """Whether a frame's window is less than a grey level wide, so that it would show nothing."""
    width = header.number("WindowWidth", frame)
    return bool(width < 1 and (width <= 0 or header.word("VOILUTFunction") in ("", "LINEAR")))


def _brightness(header: Header, frame: int, levels: np.ndarray) -> np.ndarray | None:
    """Brightness (levels,) of stored values, 0 to 1, beyond where the window cuts; None without a window or table."""
    items = header.find("VOILUTSequence", frame)
    if items is not None:
        with silent():
            try:
                count, first, bits = (int(number) for number in items[0].LUTDescriptor)
                data = items[0].LUTData
                if isinstance(data, bytes):  # words in the file's byte order, of one or, up to 8 bits, of two entries
                    little = header.dataset.original_encoding[1]
                    table = np.frombuffer(data, "<u2" if little else ">u2").astype("<u2")
                    if bits <= 8 and len(data) < 2 * (count or 65536):
                        table = table.view(np.uint8)
                else:
                    table = np.asarray(data)
                at = np.clip(levels - first, 0, (count or 65536) - 1).astype(int)
                return np.asarray(table.astype(float)[at] / (2.0**bits - 1))
            except Exception:
                raise ValueError(f"{header.path}: the VOI LUT cannot be understood") from None
    centre, width = header.number("WindowCenter", frame), header.number("WindowWidth", frame)
    if np.isnan(centre) or np.isnan(width) or has_empty_window(header, frame):
        return None
    function = header.word("VOILUTFunction") or "LINEAR"
    if function == "SIGMOID":
        return 1 / (1 + np.exp(-4 * (levels - centre) / width))
    if function == "LINEAR_EXACT":
        return (levels - centre) / width + 0.5
    if width == 1:
        return (levels > centre - 0.5).astype(float)
    return (levels - (centre - 0.5)) / (width - 1) + 0.5


def _check_layout(header: Header) -> None:
    samples, bits, stored, high = (
        header.number(name) for name in ("SamplesPerPixel", "BitsAllocated", "BitsStored", "HighBit")
    )
    rows, columns = header.number("Rows"), header.number("Columns")
    if np.isnan([samples, bits, stored, high, rows, columns]).any():
        raise ValueError(f"{header.path}: expected pictures, found a DICOM file that does not say their size and bits")
    if samples != 1 or not header.word("PhotometricInterpretation").startswith("MONOCHROME"):
        raise ValueError(f"{header.path}: expected grey pictures, found colour ones")
    if bits not in (8, 16) or not 1 <= stored <= bits or high != stored - 1 or header.number("PixelRepresentation") > 0:
        raise ValueError(
            f"{header.path}: expected unsigned pixels of 8 or 16 bits, the low ones stored, found {stored:g} of "
            f"{bits:g} bits, the highest {high:g}{', signed' if header.number('PixelRepresentation') > 0 else ''}"
        )
    if not (1 <= rows <= _LARGEST_PX and 1 <= columns <= _LARGEST_PX and frame_count(header) >= 1):
        raise ValueError(
            f"{header.path}: expected frames of up to {_LARGEST_PX} px a side, found {frame_count(header)} of "
            f"{columns:g} x {rows:g} px"
        )


def _check_decoder(header: Header, syntax: object) -> None:
    from pydicom.pixels import get_decoder

    try:
        available = get_decoder(str(syntax)).is_available
    except (NotImplementedError, ValueError):
        available = False
    if available:
        return
    lossless = str(syntax) in _JPEG_LOSSLESS
    kind = "JPEG lossless" if lossless else getattr(syntax, "name", "") if _known(str(syntax)) else "an unknown way"
    remedy = "pip install 'endonav-guide3d[lossless]'" if lossless else "save the run as JPEG lossless or uncompressed"
    raise ValueError(f"{header.path}: its pictures are compressed ({kind}) and no decoder is installed: {remedy}")


def _check_length(header: Header) -> None:
    """Counts the frames of plain pixels where the file does not say how many; more than it says are damage."""
    size = int(header.number("Rows") * header.number("Columns") * header.number("BitsAllocated")) // 8
    frames = len(header.dataset.PixelData) // size
    if np.isnan(header.number("NumberOfFrames")):
        header.dataset.NumberOfFrames = max(frames, 1)
    elif frames > frame_count(header):
        raise ValueError(f"{header.path}: expected {frame_count(header)} frames, found pixels of {frames}")


def _check_jpeg(header: Header) -> None:
    """Counts the compressed images where the file does not say how many; each has to have its end."""
    from pydicom.encaps import generate_fragments, generate_frames

    data = header.dataset.PixelData
    try:
        if np.isnan(header.number("NumberOfFrames")):
            starts = sum(fragment.startswith(_STARTS) for fragment in generate_fragments(data[_table_bytes(data) :]))
            header.dataset.NumberOfFrames = max(starts, 1)
        frames = list(generate_frames(data, number_of_frames=frame_count(header)))
    except Exception:
        frames = []
    whole = [frame for frame in frames if b"\xff\xd9" in frame[-4:]]  # an odd length is filled up
    if not len(whole) == len(frames) == frame_count(header):
        raise ValueError(
            f"{header.path}: expected {frame_count(header)} compressed frames, found {len(whole)}: the file is cut off"
        )
    if any(map(is_damaged_jpeg, frames)):
        raise ValueError(f"{header.path}: the compressed pictures are damaged")


def _table_bytes(data: bytes) -> int:
    """Length of the item at the start that says where frames begin."""
    return 8 + int.from_bytes(data[4:8], "little")


def _known(syntax: str) -> bool:
    from pydicom.uid import UID_dictionary

    return syntax in UID_dictionary
