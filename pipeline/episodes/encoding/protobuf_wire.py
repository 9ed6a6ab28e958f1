"""The protobuf wire format: the few rules needed to write large numeric messages without copies."""

from __future__ import annotations

from functools import lru_cache

VARINT, FIXED64, DELIMITED, FIXED32 = 0, 1, 2, 5


@lru_cache(maxsize=4096)  # the lengths in a log repeat from step to step
def varint(value: int) -> bytes:
    """Encode a non-negative integer: its base-128 bytes, least significant group first."""
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


@lru_cache(maxsize=8)  # all messages of a step bear the same time
def timestamp(number: int, time_ns: int) -> bytes:
    """Encode a `google.protobuf.Timestamp` field.

    Args:
        time_ns: nanoseconds since the epoch, at least 0.
    """
    seconds, nanos = divmod(time_ns, 1_000_000_000)
    return delimited(number, b"\x08" + varint(seconds) + b"\x10" + varint(nanos))
