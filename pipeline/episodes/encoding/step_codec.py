"""The codec of `endonav.Step` and `endonav.Devices`, and the rules of the protobuf wire format that it needs.

Steps go from numpy arrays straight to protobuf bytes, without copies of large arrays, and back by the protobuf library,
which does both for devices.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError
from google.protobuf.unknown_fields import UnknownFieldSet
from numpy.typing import NDArray

from pipeline.episodes.encoding.schema import DEVICE_FIELDS, EXTRA_FIELD_NUMBER, STEP_FIELDS, Devices, Step, StepField
from pipeline.episodes.records import DeviceRecord, StepRecord

VARINT, FIXED64, DELIMITED = 0, 1, 2


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
    """Encode the key that stands before a field: its number and wire type."""
    return varint(number << 3 | wire_type)


def delimited(number: int, payload: bytes) -> bytes:
    """Encode a string, bytes, packed or message field."""
    return tag(number, DELIMITED) + varint(len(payload)) + payload


@lru_cache(maxsize=8)  # all messages of a step bear the same time
def timestamp(number: int, time_ns: int) -> bytes:
    """Encode a `google.protobuf.Timestamp` field of nanoseconds since the epoch, at least 0."""
    seconds, nanos = divmod(time_ns, 1_000_000_000)
    return delimited(number, b"\x08" + varint(seconds) + b"\x10" + varint(nanos))


_DOUBLE = struct.Struct("<d")
_LITTLE_ENDIAN = np.dtype("<f8")


def _scalar_tag(name: str, wire_type: int) -> bytes:
    return tag(STEP_FIELDS[name].number, wire_type)


_STEP_TAG = _scalar_tag("step", VARINT)
_REWARD_TAG = _scalar_tag("reward", FIXED64)
_NORM_TAG = _scalar_tag("resultant_force_norm", FIXED64)
_INSERTION_TAG = _scalar_tag("insertion", FIXED64)
_ROTATION_TAG = _scalar_tag("rotation", FIXED64)
_FLAGS = {
    (terminated, truncated): _scalar_tag("terminated", VARINT)
    + bytes((terminated,))
    + _scalar_tag("truncated", VARINT)
    + bytes((truncated,))
    for terminated in (False, True)
    for truncated in (False, True)
}


@lru_cache(maxsize=4096)
def _packed_head(name: str, size: int) -> bytes:
    """Key and length of a packed field of so many bytes; lengths repeat from step to step."""
    return tag(STEP_FIELDS[name].number, DELIMITED) + varint(size)


@lru_cache(maxsize=4096)
def _extra_head(key: str) -> bytes:
    """All bytes of a map entry that precede its value."""
    head = delimited(1, key.encode())
    return tag(EXTRA_FIELD_NUMBER, DELIMITED) + varint(len(head) + 9) + head + tag(2, FIXED64)


def encode_step(record: StepRecord) -> bytes:
    """Serialise a record as an `endonav.Step`, as the protobuf library would, with zero scalars written out."""
    pack = _DOUBLE.pack
    parts = [_STEP_TAG, varint(record.step)]

    def packed(name: str, array: NDArray[np.float64]) -> None:
        if array.size:
            data = array.astype(_LITTLE_ENDIAN, copy=False).tobytes()
            parts.append(_packed_head(name, len(data)))
            parts.append(data)

    packed("action", record.action)
    parts += (_REWARD_TAG, pack(record.reward), _FLAGS[bool(record.terminated), bool(record.truncated)])
    packed("joint_positions", record.joint_positions)
    packed("joint_velocities", record.joint_velocities)
    packed("wire_points", record.wire_points)
    packed("tip", record.tip)
    packed("contact_positions", record.contact_positions)
    packed("contact_forces", record.contact_forces)
    packed("resultant_force", record.resultant_force)
    parts += (_NORM_TAG, pack(record.resultant_force_norm))
    parts += (_INSERTION_TAG, pack(record.insertion), _ROTATION_TAG, pack(record.rotation))
    for key, value in record.extra.items():
        parts += (_extra_head(key), pack(value))
    return b"".join(parts)


def encode_devices(step: int, record: DeviceRecord) -> bytes:
    """Serialise both devices of a step as an `endonav.Devices` message."""
    values = {name: getattr(record, name) for name in DEVICE_FIELDS if name != "step"}
    arrays = {name: value.ravel() if isinstance(value, np.ndarray) else value for name, value in values.items()}
    return bytes(Devices(step=step, **arrays).SerializeToString())


def decode_step(data: bytes, devices: bytes | None = None) -> StepRecord:
    """Read an `endonav.Step`, and `endonav.Devices` if there is a catheter; a ValueError where bytes are none such."""
    return decode_with_norm(data, devices)[0]


def decode_with_norm(data: bytes, devices: bytes | None = None) -> tuple[StepRecord, float]:
    """Read a message, and the force's norm in newtons as it stands there, to compare it with the vector."""
    message, values = _decode(Step, STEP_FIELDS, data)
    norm = values.pop("resultant_force_norm")
    both = None if devices is None else decode_devices(devices)[1]
    return StepRecord(**values, extra=dict(message.extra), devices=both), norm


def decode_devices(data: bytes) -> tuple[int, DeviceRecord]:
    """Read an `endonav.Devices` message: the step's index, and the devices; raises as `decode_step` does."""
    _, values = _decode(Devices, DEVICE_FIELDS, data)
    return values.pop("step"), DeviceRecord(**values)


def _decode(kind: Any, fields: dict[str, StepField], data: bytes) -> tuple[Any, dict[str, Any]]:
    """Read a message and its fields, the arrays in their shapes."""
    try:
        message = kind.FromString(data)
    except DecodeError as error:
        raise ValueError(f"the bytes are no message of a step: {error}") from error
    names = {field.number: name for name, field in fields.items()}
    unknown_fields: Any = UnknownFieldSet(message)
    for unknown in unknown_fields:
        if unknown.field_number in names:
            name = names[unknown.field_number]
            raise ValueError(f"{name} has wire type {unknown.wire_type}, which its type forbids")
    values: dict[str, Any] = {}
    for name, field in fields.items():
        value = getattr(message, name)
        if field.shape:
            value = np.array(value, dtype=np.float64)
            width = field.shape[-1]
            if width > 0 and value.size % width:
                raise ValueError(f"{name} must hold a multiple of {width} numbers, got {value.size}")
            value = value.reshape(field.shape) if len(field.shape) > 1 else value
        values[name] = value
    return message, values
