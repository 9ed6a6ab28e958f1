"""Values of a volume's file, packed or not: exactly as many bytes as its header says, read to the file's very end."""

from __future__ import annotations

import bz2
import gzip
import io
import os
import zlib
from pathlib import Path
from typing import BinaryIO

from cathsim.guarded_reading import open_regular

SLAB_BYTES = 1 << 23
# what damaged files make readers raise
BROKEN = (
    OSError, EOFError, ValueError, KeyError, TypeError, IndexError, OverflowError, ZeroDivisionError, MemoryError,
    zlib.error, RecursionError,
)  # fmt: skip
_PADDING = 1 << 16  # zero bytes behind the values that some programs write


class _Bzip2:
    """What a file holds packed by bzip2; unlike `bz2.BZ2File` it does not pass over what follows."""

    def __init__(self, file: BinaryIO) -> None:
        self._file, self._unpacker = file, bz2.BZ2Decompressor()

    def read(self, count: int) -> bytes:
        data = bytearray()
        while len(data) < count and not self._unpacker.eof:
            block = self._file.read(_PADDING) if self._unpacker.needs_input else b""
            if self._unpacker.needs_input and not block:
                raise EOFError("it ends before its last value")
            data += self._unpacker.decompress(block, count - len(data))
        if self._unpacker.eof and any(self._unpacker.unused_data + self._file.read(_PADDING)):
            raise OSError("something follows its values")
        return bytes(data)


class ValueStream:
    """Bytes of a file's values; what packs them is believed only after `finish`, which reads its checksum.

    Args:
        path: of a regular file.
        start: first byte of what follows a header.
        packing: "", "gzip" or "bzip2", of all from `start` on.

    Raises:
        UnreadableFileError: it is no regular file.
    """

    def __init__(self, path: Path, start: int = 0, packing: str = "") -> None:
        self._file: BinaryIO = open_regular(path)
        self._file.seek(start)
        self._values: io.BufferedIOBase | BinaryIO | _Bzip2 = self._file
        self.unpack(packing)

    @classmethod
    def of(cls, content: bytes) -> ValueStream:
        """Of values that are read already."""
        stream = cls.__new__(cls)
        stream._file = stream._values = io.BytesIO(content)
        return stream

    def unpack(self, packing: str) -> None:
        """Takes what follows for packed by "gzip" or "bzip2", or for what it is ("")."""
        if packing == "gzip":
            self._values = gzip.GzipFile(fileobj=self._file)
        elif packing == "bzip2":
            self._values = _Bzip2(self._file)

    def size_left(self) -> int:
        """Bytes of the file from here on, as they are packed."""
        return os.fstat(self._file.fileno()).st_size - self._file.tell()

    def skip_lines(self, count: int) -> None:
        """Leaves out lines of the file, before what packs the values.

        Raises:
            EOFError: there are fewer.
        """
        for _ in range(count):
            if not self._file.readline():
                raise EOFError("it ends within the lines that its header skips")

    def skip(self, count: int) -> None:
        """Leaves out bytes.

        Raises:
            EOFError: there are fewer.
        """
        if count < 0:
            raise EOFError("it ends before its last value")
        while count > 0:
            count -= len(self.read(min(count, SLAB_BYTES)))

    def read(self, count: int) -> bytes:
        """Exactly so many bytes.

        Raises:
            EOFError: there are fewer.
        """
        content = self._values.read(count)
        if len(content) != count:
            raise EOFError("it ends before its last value")
        return content

    def rest(self) -> bytes:
        """All bytes of the file that are left."""
        return self._file.read()

    def finish(self) -> None:
        """Reads to the end, so that checksums are compared.

        Raises:
            OSError: a checksum does not fit, or something else follows what is packed.
            ValueError: more values follow.
        """
        behind = self._values.read(_PADDING + 1)
        self._file.close()
        if len(behind) > _PADDING or any(behind):
            raise ValueError("it holds more values than its header says")


def in_words(error: BaseException) -> str:
    """The beginning of an error's message, for a sentence: libraries quote whole values."""
    text = str(error).strip()
    return text.splitlines()[0][:200].rstrip(".") if text else type(error).__name__
