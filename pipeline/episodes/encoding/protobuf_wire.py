"""The protobuf wire format: the few rules needed to write and read large numeric messages without copies."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from functools import lru_cache

VARINT, FIXED64, DELIMITED, FIXED32 = 0, 1, 2, 5
_DOUBLE = struct.Struct("<d")


@lru_cache(maxsize=4096)  # the lengths in a log repeat from step to step
def varint(value: int) -> bytes:
    """Encode a non-negative integer.

    Returns:
        Its base-128 bytes, least significant group first.
    """
    if value < 0x80:
        return bytes((value,))
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


@lru_cache(maxsize=256)
def tag(number: int, wire_type: int) -> bytes:
    """Encode the key that stands before a field.

    Args:
        wire_type: VARINT, FIXED64, DELIMITED or FIXED32.
    """
    return varint(number << 3 | wire_type)


def delimited(number: int, payload: bytes) -> bytes:
    """Encode a string, bytes, packed or message field."""
    return tag(number, DELIMITED) + varint(len(payload)) + payload


def double(number: int, value: float) -> bytes:
    """Encode a double field.

    Returns:
        Key and eight bytes.
    """
    return tag(number, FIXED64) + _DOUBLE.pack(value)


@lru_cache(maxsize=8)  # all messages of a step bear the same time
def timestamp(number: int, time_ns: int) -> bytes:
    """Encode a `google.protobuf.Timestamp` field.

    Args:
        time_ns: nanoseconds since the epoch, at least 0.
    """
    seconds, nanos = divmod(time_ns, 1_000_000_000)
    return delimited(number, b"\x08" + varint(seconds) + b"\x10" + varint(nanos))


def _read_varint(data: bytes, position: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[position]
        position += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, position
        shift += 7
        if shift > 63:
            raise ValueError("a varint is longer than ten bytes")


def fields(data: bytes) -> Iterator[tuple[int, int, int, int]]:
    """Walk over the fields of a message.

    Yields:
        Field number, wire type, start and end of the field's content; a VARINT has its value in place of the start.

    Raises:
        ValueError: the bytes are no message.
    """
    position, size = 0, len(data)
    try:
        while position < size:
            key, position = _read_varint(data, position)
            wire_type = key & 7
            if wire_type == VARINT:
                value, position = _read_varint(data, position)
                yield key >> 3, wire_type, value, position
                continue
            if wire_type == DELIMITED:
                length, position = _read_varint(data, position)
            elif wire_type == FIXED64:
                length = 8
            elif wire_type == FIXED32:
                length = 4
            else:
                raise ValueError(f"wire type {wire_type} is unknown")
            end = position + length
            if end > size:
                raise ValueError("a field reaches beyond the end of its message")
            yield key >> 3, wire_type, position, end
            position = end
    except IndexError:
        raise ValueError("the message ends within a field") from None
