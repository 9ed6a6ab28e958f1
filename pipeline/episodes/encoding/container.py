"""The MCAP container, written so that a killed process leaves every flushed chunk whole.

Chunks go to the file in one positioned write each, at the end of what is known to be whole: a write that fails half-way
(a full disk, an interrupt) is cut off again and can be repeated. Nothing is synchronised to the disk platter, so a kill
of the process costs only what was not flushed, while a power failure may cost more.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import struct
import zlib
from collections import defaultdict
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from pathlib import Path

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

from pipeline.episodes.encoding.schema import PROFILE

MAX_CHUNK_BYTES = 256 * 1024
"""A chunk is closed before it grows beyond this (a single message that is larger gets a chunk of its own)."""

_ZSTD_LEVEL = -1  # on real episodes 3 % larger than level 1, at less than half its time
_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
_MESSAGE_FIXED = _MESSAGE_HEAD.size - 9  # the record's length does not count opcode and length
_LIBRARY = f"endonav episodes, mcap {version('mcap')}"


def record_bytes(record: McapRecord) -> bytes:
    """Serialise one MCAP record."""
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


class McapFile:
    """An MCAP file being written: channels and metadata, chunks of messages, and at the end the index."""

    def __init__(self, path: Path) -> None:
        """Create the file, which must not exist."""
        self.path = path
        self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)  # see `is_being_written`
        self._end = 0
        self._crc = 0
        self._compressor = zstandard.ZstdCompressor(level=_ZSTD_LEVEL)
        self._schemas: dict[bytes, Schema] = {}
        self._channels: dict[str, Channel] = {}
        self._chunk_indexes: list[ChunkIndex] = []
        self._metadata_indexes: list[MetadataIndex] = []
        self._counts: dict[int, int] = defaultdict(int)
        self._preamble = MCAP0_MAGIC + record_bytes(Header(profile=PROFILE, library=_LIBRARY))
        self._start_chunk()

    def _start_chunk(self) -> None:
        self._parts: list[bytes] = []
        self._offsets: dict[int, list[tuple[int, int]]] = {}
        self._first_ns, self._last_ns = 2**64 - 1, 0
        self.pending_bytes = 0

    def _append(self, data: bytes) -> int:
        """Write at the known end, and move that end only once all bytes are there; return where they start."""
        start, view, done = self._end, memoryview(data), 0
        try:
            while done < len(view):
                done += os.pwrite(self._fd, view[done:], start + done)
        except BaseException:
            with contextlib.suppress(OSError):
                os.ftruncate(self._fd, start)
            raise
        self._end = start + len(view)
        self._crc = zlib.crc32(data, self._crc)
        return start

    def register(self, topic: str, schema_name: str, schema_data: bytes, encoding: str = "protobuf") -> int:
        """Declare a topic, before or between chunks, by its schema's name and bytes; gives its channel: 1, 2, ..."""
        schema = self._schemas.get(schema_data)
        if schema is None:
            schema = Schema(id=len(self._schemas) + 1, name=schema_name, encoding=encoding, data=schema_data)
            self._schemas[schema_data] = schema
            self._preamble += record_bytes(schema)
        channel = Channel(
            id=len(self._channels) + 1, topic=topic, message_encoding=encoding, metadata={}, schema_id=schema.id
        )
        self._channels[topic] = channel
        self._preamble += record_bytes(channel)
        return channel.id

    def add(self, channel_id: int, log_time_ns: int, sequence: int, payload: bytes) -> None:
        """Add a message to the chunk in memory; its sequence is the step's index."""
        size = len(payload)
        self._parts.append(
            _MESSAGE_HEAD.pack(
                Opcode.MESSAGE, _MESSAGE_FIXED + size, channel_id, sequence & 0xFFFFFFFF, log_time_ns, log_time_ns
            )
        )
        self._parts.append(payload)
        self._offsets.setdefault(channel_id, []).append((log_time_ns, self.pending_bytes))
        if log_time_ns < self._first_ns:
            self._first_ns = log_time_ns
        if log_time_ns > self._last_ns:
            self._last_ns = log_time_ns
        self.pending_bytes += _MESSAGE_HEAD.size + size

    def flush(self) -> None:
        """Hand the compressed chunk to the operating system; after an OSError it is still here, to be tried again."""
        if self._preamble:
            self._append(self._preamble)
            self._preamble = b""
        if not self._parts:
            return
        data = b"".join(self._parts)
        compressed = self._compressor.compress(data)
        first, last = self._first_ns, self._last_ns
        chunk = record_bytes(Chunk("zstd", compressed, last, first, zlib.crc32(data), len(data)))
        records, index_offsets = [chunk], {}
        index_start = position = self._end + len(chunk)
        for channel_id, entries in self._offsets.items():
            index_offsets[channel_id] = position
            records.append(record_bytes(MessageIndex(channel_id, entries)))
            position += len(records[-1])
        start = self._append(b"".join(records))
        self._chunk_indexes.append(
            ChunkIndex(
                chunk_length=len(chunk),
                chunk_start_offset=start,
                compression="zstd",
                compressed_size=len(compressed),
                message_end_time=last,
                message_index_length=position - index_start,
                message_index_offsets=index_offsets,
                message_start_time=first,
                uncompressed_size=len(data),
            )
        )
        for channel_id, entries in self._offsets.items():
            self._counts[channel_id] += len(entries)
        self._start_chunk()

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record now, after what is in memory."""
        self.flush()
        record = record_bytes(Metadata(name=name, metadata=dict(values)))
        self._metadata_indexes.append(MetadataIndex(offset=self._append(record), length=len(record), name=name))

    def _summary(self, start: int) -> bytes:
        """Build the summary section and the footer for a file whose summary starts at `start`."""
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=len(self._chunk_indexes),
            message_count=sum(self._counts.values()),
            message_start_time=min((index.message_start_time for index in self._chunk_indexes), default=0),
            message_end_time=max((index.message_end_time for index in self._chunk_indexes), default=0),
            metadata_count=len(self._metadata_indexes),
            schema_count=len(self._schemas),
        )
        groups: tuple[tuple[Opcode, list[McapRecord]], ...] = (
            (Opcode.SCHEMA, list(self._schemas.values())),
            (Opcode.CHANNEL, list(self._channels.values())),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, list(self._chunk_indexes)),
            (Opcode.METADATA_INDEX, list(self._metadata_indexes)),
        )
        summary, offsets = b"", b""
        for opcode, records in groups:
            group = b"".join(map(record_bytes, records))
            if group:
                offset = SummaryOffset(group_opcode=opcode, group_start=start + len(summary), group_length=len(group))
                offsets += record_bytes(offset)
                summary += group
        offset_start = start + len(summary)
        summary += offsets
        footer_head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offset_start)
        crc = zlib.crc32(footer_head, zlib.crc32(summary))
        footer = Footer(summary_start=start, summary_offset_start=offset_start, summary_crc=crc)
        return summary + record_bytes(footer) + MCAP0_MAGIC

    def close_with_index(self) -> None:
        """Flush, write the index and close; after an OSError the file is open without index, to be tried again."""
        self.flush()
        data_end = record_bytes(DataEnd(self._crc))
        self._append(data_end + self._summary(self._end + len(data_end)))
        self.close()

    @property
    def in_place(self) -> bool:
        """Whether the open file still has its name: nobody removed, moved or replaced it."""
        try:
            return os.path.samestat(os.fstat(self._fd), os.stat(self.path))
        except OSError:
            return False

    @property
    def closed(self) -> bool:
        """Whether the file was closed."""
        return self._fd < 0

    def close(self) -> None:
        """Close the file as it is; closing again does nothing."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


def is_being_written(path: Path) -> bool:
    """Whether an `McapFile` of this or another process has the file open."""
    try:
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)  # of a pipe, too
    except OSError:
        return False
    try:
        fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # a file system without locks
        return False
    finally:
        os.close(fd)
    return False


@contextlib.contextmanager
def replacing(destination: Path, suffix: str) -> Iterator[McapFile]:
    """Lend a file beside the destination that takes its place in one instant when the body has written it."""
    temporary = destination.with_name(destination.name + suffix)
    destination.parent.mkdir(parents=True, exist_ok=True)
    if is_being_written(temporary):
        raise BlockingIOError(errno.EBUSY, "another process writes it")
    temporary.unlink(missing_ok=True)
    out = McapFile(temporary)
    try:
        yield out
        out.close_with_index()
        os.replace(temporary, destination)
    finally:
        out.close()
        temporary.unlink(missing_ok=True)
