"""The codec of `endonav.Step` and `endonav.Devices`: numpy arrays to protobuf bytes and back."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError
from google.protobuf.unknown_fields import UnknownFieldSet

from pipeline.episodes.encoding.schema import DEVICE_FIELDS, STEP_FIELDS, Devices, Step, StepField
from pipeline.episodes.records import DeviceRecord, StepRecord


def encode_step(record: StepRecord) -> bytes:
    """Serialise a record as an `endonav.Step`."""
    extra = {key: float(value) for key, value in record.extra.items()}
    return _encode(Step, {name: getattr(record, name) for name in STEP_FIELDS}, extra=extra)


def encode_devices(step: int, record: DeviceRecord) -> bytes:
    """Serialise both devices of a step as an `endonav.Devices` message."""
    return _encode(Devices, {name: getattr(record, name, step) for name in DEVICE_FIELDS})


def _encode(kind: Any, values: dict[str, Any], **further: Any) -> bytes:
    arrays = {name: np.asarray(value) for name, value in values.items()}
    plain = {name: array.ravel().tolist() if array.ndim else array.item() for name, array in arrays.items()}
    return bytes(kind(**plain, **further).SerializeToString(deterministic=True))


def decode_step(data: bytes, devices: bytes | None = None) -> StepRecord:
    """Read an `endonav.Step`, and `endonav.Devices` if there is a catheter; a ValueError where bytes are none such."""
    message, values = _decode(Step, STEP_FIELDS, data)
    norm, both = values.pop("resultant_force_norm"), None
    if devices is not None:
        _, of_devices = _decode(Devices, DEVICE_FIELDS, devices)
        if (step := of_devices.pop("step")) != values["step"]:
            raise ValueError(f"the devices of step {values['step']} are those of step {step}")
        both = DeviceRecord(**of_devices)
    record = StepRecord(**values, extra=dict(message.extra), devices=both)
    known = record.resultant_force_norm
    if not math.isclose(norm, known, rel_tol=1e-9, abs_tol=1e-12) and math.isfinite(known):
        raise ValueError(f"step {record.step} has force norm {norm}, its vector {known}")
    return record


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
