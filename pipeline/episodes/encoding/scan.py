"""The MCAP container, read with every checksum verified: summary, chunks, messages, and a walk that survives damage.

Every function raises a `ContainerError` where what it reads is damaged, cut off or not there.
"""

from __future__ import annotations

import os
import re
import stat
import struct
import zlib
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any, NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Metadata, MetadataIndex, Schema, Statistics
from mcap.writer import MCAP0_MAGIC

from pipeline.episodes.encoding.schema import EPISODE_METADATA, OUTCOME_METADATA
from pipeline.episodes.records import ContainerError, EpisodeReadError, VersionError

_RECORD_HEAD = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
_CHUNK_HEAD = struct.Struct("<QQQII")
_FOOTER = struct.Struct("<BQQQI")
_MAX_UNCOMPRESSED = 1 << 26  # a writer's chunks are far smaller, but for a mesh or a picture that is a chunk by itself
_MAX_SUMMARY = 1 << 28
_ALWAYS_UNPACKED = 1 << 28  # bytes that any log may unpack to, and times its size: real ones unpack to 1 to 4 times it,
_MOST_UNPACKED = 500  # and pictures that are all black to a few hundred times
_MAX_MESSAGES = 100_000  # of a chunk


class MessageSpan(NamedTuple):
    """A message within the bytes of a chunk."""

    channel_id: int
    log_time_ns: int
    start: int
    end: int

    @property
    def record_start(self) -> int:
        """Where the message's record begins."""
        return self.start - _MESSAGE_HEAD.size


@dataclass
class Summary:
    """The index at the end of a file."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunk_indexes: list[ChunkIndex] = field(default_factory=list)
    metadata_indexes: list[MetadataIndex] = field(default_factory=list)
    statistics: Statistics | None = None


def parse_record(kind: Any, content: bytes) -> Any:
    """Parse the content of a record: its bytes after opcode and length."""
    try:
        return kind.read(ReadDataStream(BytesIO(content)))
    except (McapError, struct.error, ValueError, EOFError, OverflowError) as error:
        raise ContainerError(f"a {kind.__name__} record cannot be parsed") from error


def open_log(path: str | os.PathLike[str]) -> int:
    """Open a log for reading, which must be a regular file: a pipe or a device may have no end."""
    try:
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    except (OSError, ValueError) as error:
        raise EpisodeReadError(f"cannot open {path}: {getattr(error, 'strerror', error)}; check the path") from error
    if not stat.S_ISREG(os.fstat(fd).st_mode):
        os.close(fd)
        raise EpisodeReadError(f"cannot open {path}: it is no regular file; give the path of an episode log")
    return fd


def require_proportion(unpacked: int, size: int) -> None:
    """Refuse a log of so many bytes that unpacks to so many that only a forger makes it."""
    if unpacked > _ALWAYS_UNPACKED + _MOST_UNPACKED * size:
        raise ContainerError(f"it unpacks to {unpacked / 1e9:.1f} GB, {unpacked // size} times its size")


def check_magic(fd: int) -> int:
    """Check that a file begins as MCAP, and give its size in bytes."""
    size = os.fstat(fd).st_size
    if size == 0:
        raise VersionError("it is empty, so it is no episode log; give the path of one")
    if os.pread(fd, len(MCAP0_MAGIC), 0) != MCAP0_MAGIC:
        raise VersionError(
            "it does not begin as an MCAP file, so it is no episode log; give the path of one "
            "(where the beginning of a log is damaged, recover saves the rest)"
        )
    return size


def read_summary(fd: int) -> Summary:
    """Read the index at the end of a file, its checksum verified."""
    size = check_magic(fd)
    tail = _FOOTER.size + len(MCAP0_MAGIC)
    ending = os.pread(fd, tail, size - tail) if size >= tail + len(MCAP0_MAGIC) else b""
    if ending[_FOOTER.size :] != MCAP0_MAGIC or ending[0] != Opcode.FOOTER:
        raise ContainerError("it has no index at its end, so its writer was stopped or the file was cut off")
    _, length, start, _, crc = _FOOTER.unpack_from(ending)
    if length != _FOOTER.size - 9 or not 0 < start <= size - tail or size - start > _MAX_SUMMARY:
        raise ContainerError("the end of its index is malformed")
    content = os.pread(fd, size - tail - start, start)
    if zlib.crc32(ending[: _FOOTER.size - 4], zlib.crc32(content)) != crc:
        raise ContainerError("the checksum of its index does not match")
    summary = Summary()
    for opcode, begin, end in walk(content):
        if opcode == Opcode.SCHEMA:
            schema = parse_record(Schema, content[begin:end])
            summary.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = parse_record(Channel, content[begin:end])
            summary.channels[channel.id] = channel
        elif opcode == Opcode.CHUNK_INDEX:
            summary.chunk_indexes.append(parse_record(ChunkIndex, content[begin:end]))
        elif opcode == Opcode.METADATA_INDEX:
            summary.metadata_indexes.append(parse_record(MetadataIndex, content[begin:end]))
        elif opcode == Opcode.STATISTICS:
            summary.statistics = parse_record(Statistics, content[begin:end])
    if len({index.chunk_start_offset for index in summary.chunk_indexes}) < len(summary.chunk_indexes):
        raise ContainerError("its index names a chunk twice")
    require_proportion(sum(index.uncompressed_size for index in summary.chunk_indexes), size)
    return summary


def _read(fd: int, length: int, offset: int) -> bytes:
    """Bytes that an index names; none when they do not lie in the file, so that no more is asked for than is there."""
    return os.pread(fd, length, offset) if offset + length <= os.fstat(fd).st_size else b""


def read_metadata(fd: int, index: MetadataIndex) -> Metadata:
    """Read the metadata record that an index names."""
    data = _read(fd, index.length, index.offset)
    if data[:1] != bytes((Opcode.METADATA,)):
        raise ContainerError(f"the metadata record {index.name} is not where the index says")
    metadata: Metadata = parse_record(Metadata, data[9:])
    return metadata


def read_chunk(fd: int, index: ChunkIndex) -> bytes:
    """Read and decompress the chunk that an index names, its checksum verified."""
    data = _read(fd, index.chunk_length, index.chunk_start_offset)
    if data[:1] != bytes((Opcode.CHUNK,)):
        raise ContainerError(f"the chunk at byte {index.chunk_start_offset} is not where the index says")
    chunk = open_chunk(data[9:], index.chunk_start_offset)
    if len(chunk) != index.uncompressed_size:
        raise ContainerError(f"the chunk at byte {index.chunk_start_offset} has another size than the index says")
    return chunk


def unpacked_bytes(content: bytes) -> int:
    """What the content of a chunk says that it unpacks to, as far as it is believed."""
    return min(int.from_bytes(content[16:24], "little"), _MAX_UNCOMPRESSED)


def open_chunk(content: bytes, offset: int) -> bytes:
    """Decompress a chunk to its records and verify its checksum; `offset`: where it begins in the file."""
    where = f"the chunk at byte {offset}"
    try:
        _, _, size, crc, name_length = _CHUNK_HEAD.unpack_from(content)
        position = _CHUNK_HEAD.size + name_length
        compression = content[_CHUNK_HEAD.size : position]
        compressed = content[position + 8 :]
        if size > _MAX_UNCOMPRESSED or struct.unpack_from("<Q", content, position)[0] != len(compressed):
            raise ContainerError(f"{where} has an impossible size")
        if compression == b"zstd":
            if zstandard.get_frame_parameters(compressed).content_size not in (0, size):  # it would be believed
                raise ContainerError(f"{where} has an impossible size")
            data = zstandard.ZstdDecompressor().decompress(compressed, max_output_size=size)
        elif compression == b"":
            data = compressed
        else:
            raise ContainerError(f"{where} is compressed as {compression!r}, expected zstd")
    except (struct.error, zstandard.ZstdError) as error:
        raise ContainerError(f"{where} cannot be decompressed") from error
    if len(data) != size or zlib.crc32(data) != crc:
        raise ContainerError(f"the checksum of {where} does not match")
    return data


def messages(chunk: bytes) -> Iterator[MessageSpan]:
    """List the messages of a chunk: channel, time, and where the payload lies in `chunk`."""
    count, fixed = 0, _MESSAGE_HEAD.size - 9
    for opcode, start, end in walk(chunk, whole="a chunk"):
        if opcode == Opcode.MESSAGE and end - start >= fixed:
            _, _, channel_id, _, log_time_ns, _ = _MESSAGE_HEAD.unpack_from(chunk, start - 9)
            count += 1
            if count > _MAX_MESSAGES:
                raise ContainerError(f"a chunk holds more than {_MAX_MESSAGES} messages")
            yield MessageSpan(channel_id, log_time_ns, start + fixed, end)


def walk(data: Any, start: int = 0, whole: str = "it") -> Iterator[tuple[int, int, int]]:
    """Walk over the records of a buffer, named so in errors: opcode, and where the record's content begins and ends."""
    position, size = start, len(data)
    while position < size:
        if position + 9 > size:
            raise ContainerError(f"{whole} is cut off at byte {size}")
        opcode, length = _RECORD_HEAD.unpack_from(data, position)
        end = position + 9 + length
        if end > size:
            raise ContainerError(f"{whole} has a record at byte {position} that reaches beyond its end")
        yield opcode, position + 9, end
        position = end


# What stands where in a record that is looked for: bytes, how far behind the record's start, and its kind.
_PATTERNS = {b"\x04\x00\x00\x00zstd": (9 + _CHUNK_HEAD.size - 4, Opcode.CHUNK)} | {
    struct.pack("<I", len(name)) + name.encode(): (9, Opcode.METADATA) for name in (EPISODE_METADATA, OUTCOME_METADATA)
}


_ANY_PATTERN = re.compile(b"|".join(re.escape(pattern) for pattern in _PATTERNS))


def likely_records(data: Any) -> Generator[int, None, None]:
    """Find in one pass what looks like a chunk or an episode's metadata; checksums say whether it is intact."""
    for match in _ANY_PATTERN.finditer(data):
        offset, opcode = _PATTERNS[match[0]]
        begin = match.start() - offset
        if begin >= 0 and data[begin] == opcode and begin + 9 + _RECORD_HEAD.unpack_from(data, begin)[1] <= len(data):
            yield begin
