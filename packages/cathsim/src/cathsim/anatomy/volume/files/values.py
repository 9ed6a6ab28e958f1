"""Values of a volume's file, packed or not: exactly as many as its header says, read to the file's very end."""

from __future__ import annotations

import bz2
import gzip
import io
import math
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.guarded_reading import UnreadableFileError, open_regular

# what damaged files make readers raise
BROKEN = (
    OSError, EOFError, ValueError, KeyError, TypeError, IndexError, OverflowError, ZeroDivisionError, MemoryError,
    zlib.error, RecursionError,
)  # fmt: skip
_PADDING = 1 << 16  # zero bytes behind the values that some programs write


def read_values(
    path: Path,
    kind: np.dtype[Any],
    sizes: Sequence[int],
    packing: str = "",
    *,
    data: Path | None = None,
    start: int = 0,
    lines: int = 0,
    skip: int = 0,
) -> NDArray:
    """The values (sizes) of a volume, the first axis the fastest; checksums are compared.

    Args:
        path: of its header, for messages.
        kind: type of a value.
        packing: "", "gzip" (one or several members), "bzip2", "zlib" (or gzip) or "text".
        data: regular file that holds them; None: the header's own.
        start, lines: bytes of that file before the values, and then lines, which are not packed.
        skip: bytes that are packed with the values and stand before them; -1: whatever stands before them.

    Raises:
        UnreadableFileError: it is no regular file.
        MeshRefusedError: they are damaged, cut off, or followed by something else than a few zeros.
    """
    count = math.prod(sizes)
    size = count * kind.itemsize
    try:
        with open_regular(data or path) as file:
            file.seek(start)
            for _ in range(lines):
                if not file.readline():
                    raise EOFError("it ends within the lines that its header skips")
            content = file.read()
        if packing == "text":
            values = np.array(content.split(), dtype=kind)
            if len(values) != count:
                raise ValueError(f"it holds {len(values)} values, its header says {count}")
            return values.reshape(sizes, order="F")
        view = memoryview(_unpacked(content, packing, max(skip, 0) + size + _PADDING + 1))
        skip = len(view) - size if skip < 0 else skip
        if not 0 <= skip <= len(view) - size:
            raise EOFError("it ends before its last value")
        behind = view[skip + size :]
        if len(behind) > _PADDING or any(behind):
            raise ValueError(f"it holds more values than the {size} bytes that its header says")
        return np.frombuffer(view[skip : skip + size], kind).reshape(sizes, order="F")
    except (UnreadableFileError, MemoryError):
        raise
    except BROKEN as error:
        raise MeshRefusedError(f"{path.name} is damaged: {in_words(error)}; copy or export it again.") from None


def _unpacked(content: bytes, packing: str, most: int) -> bytes:
    """What some bytes hold, at most so many; where there are no more the checksum was compared."""
    if not packing:
        return content
    if packing == "gzip":
        return gzip.GzipFile(fileobj=io.BytesIO(content)).read(most)
    unpacker: Any = bz2.BZ2Decompressor() if packing == "bzip2" else zlib.decompressobj(zlib.MAX_WBITS | 32)
    values: bytes = unpacker.decompress(content, most)
    if len(values) < most and not unpacker.eof:
        raise EOFError("it ends before its last value")
    if len(values) < most and any(unpacker.unused_data):
        raise OSError("something follows its values")
    return values


def in_words(error: BaseException) -> str:
    """The beginning of an error's message, for a sentence: libraries quote whole values."""
    text = str(error).strip()
    return text.splitlines()[0][:200].rstrip(".") if text else type(error).__name__
