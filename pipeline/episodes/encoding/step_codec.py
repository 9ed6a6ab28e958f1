"""The codec of `endonav.Step`: numpy arrays straight to protobuf bytes and back."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.episodes.encoding.protobuf_wire import DELIMITED, FIXED64, VARINT, delimited, fields, tag, varint
from pipeline.episodes.encoding.schema import EXTRA_FIELD_NUMBER, STEP_FIELDS, StepField
from pipeline.episodes.records import StepRecord

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
    """Serialise a record as an `endonav.Step` message.

    Returns:
        Protobuf bytes, as the protobuf library would write them (zero scalars are written out, which is equivalent).
    """
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


_BY_NUMBER: dict[int, tuple[str, StepField]] = {field.number: (name, field) for name, field in STEP_FIELDS.items()}
_WHOLE = ("step", "terminated", "truncated")
_NO_DOUBLES = np.zeros(0)


def _decode_extra(data: bytes) -> tuple[str, float]:
    key, value = "", 0.0
    for number, wire_type, start, end in fields(data):
        if number == 1 and wire_type == DELIMITED:
            key = data[start:end].decode()
        elif number == 2 and wire_type == FIXED64:
            value = _DOUBLE.unpack_from(data, start)[0]
    return key, value


def decode_step(data: bytes) -> StepRecord:
    """Read an `endonav.Step` message, whoever serialised it.

    Args:
        data: protobuf bytes; fields of later versions are skipped.

    Returns:
        The step; its arrays do not share memory with `data`.

    Raises:
        ValueError: the bytes are no such message, or an array's length does not fit its shape.
    """
    values, _ = _decode_fields(data)
    return StepRecord(**values)


def decode_resultant_force_norm(data: bytes) -> float:
    """Read the norm as it stands in a message, to compare it with the vector.

    Returns:
        The norm in newtons.

    Raises:
        ValueError: the bytes are no such message.
    """
    return _decode_fields(data)[1]


def _decode_fields(data: bytes) -> tuple[Mapping[str, Any], float]:
    scalars: dict[str, float] = {}
    arrays: dict[str, NDArray[np.float64]] = {}
    extra: dict[str, float] = {}
    for number, wire_type, start, end in fields(data):
        if number == EXTRA_FIELD_NUMBER and wire_type == DELIMITED:
            key, value = _decode_extra(data[start:end])
            extra[key] = value
            continue
        name, field = _BY_NUMBER.get(number, ("", StepField(0, 0)))
        if not name:
            continue
        if wire_type == VARINT and name in _WHOLE:
            scalars[name] = start
        elif wire_type == FIXED64 and not field.shape and name not in _WHOLE:
            scalars[name] = _DOUBLE.unpack_from(data, start)[0]
        elif field.shape and wire_type in (DELIMITED, FIXED64):
            # An unpacked repeated field, or one in pieces, is legal too: its parts are joined.
            if (end - start) % 8:
                raise ValueError(f"{name} is no list of doubles: it has {end - start} bytes")
            part = np.frombuffer(data, _LITTLE_ENDIAN, (end - start) // 8, start).astype(np.float64)
            arrays[name] = np.concatenate((arrays[name], part)) if name in arrays else part
        else:
            raise ValueError(f"{name} has wire type {wire_type}, which its type forbids")
    values: dict[str, Any] = {}
    for name, field in STEP_FIELDS.items():
        if field.shape:
            array = arrays.get(name, _NO_DOUBLES)
            width = field.shape[-1]
            if width > 0 and array.size % width:
                raise ValueError(f"{name} must hold a multiple of {width} numbers, got {array.size}")
            values[name] = array.reshape(field.shape) if len(field.shape) > 1 else array
        else:
            values[name] = scalars.get(name, 0.0)
    norm = values.pop("resultant_force_norm")
    values["step"] = int(values["step"])
    values["terminated"] = bool(values["terminated"])
    values["truncated"] = bool(values["truncated"])
    return {**values, "extra": extra}, norm
