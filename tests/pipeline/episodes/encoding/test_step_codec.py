"""The codec of `endonav.Step` against the protobuf library."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.episodes.encoding.schema import STEP_FIELDS, Step
from pipeline.episodes.encoding.step_codec import decode_step, encode_step, varint
from pipeline.episodes.records import StepRecord


def as_message(record: StepRecord):
    message = Step()
    for name, field in STEP_FIELDS.items():
        value = getattr(record, name)
        if field.shape:
            getattr(message, name).extend(np.ravel(value).tolist())
        else:
            setattr(message, name, value)
    for key, value in record.extra.items():
        message.extra[key] = value
    return message


def test_bytes_are_those_of_the_protobuf_library(episode):
    record = replace(episode.records[7], terminated=True, truncated=True)
    assert encode_step(record) == as_message(record).SerializeToString(deterministic=True)


@pytest.mark.parametrize("index", [0, 3])  # without contacts, and with three
def test_codec_and_library_read_each_other(episode, assert_same, index):
    record = episode.records[index]
    assert Step.FromString(encode_step(record)) == as_message(record)
    assert_same(decode_step(as_message(record).SerializeToString()), record)


def test_round_trip_keeps_special_numbers(episode, assert_same):
    record = replace(
        episode.records[4],
        step=999_999,
        joint_positions=np.array([np.nan, np.inf, -np.inf, -0.0, 5e-324, 1.7e308, 0.1]),
        reward=-0.0,
        extra={"größe_m": 1e-300, "": 0.0},
    )
    assert_same(decode_step(encode_step(record)), record)


def test_fields_of_later_versions_are_skipped_and_unpacked_doubles_read(episode, assert_same):
    data = encode_step(episode.records[3]) + b"\xfa\x01\x03abc" + b"\x80\x02\x05"
    assert_same(decode_step(data), episode.records[3])
    data = encode_step(replace(episode.records[3], action=np.zeros(0)))
    unpacked = b"\x11" + np.float64(1.5).tobytes() + b"\x11" + np.float64(-2.5).tobytes()
    np.testing.assert_array_equal(decode_step(data + unpacked).action, [1.5, -2.5])


@pytest.mark.parametrize("cut", [1, 5, 100])
def test_cut_message_is_refused(episode, cut):
    with pytest.raises(ValueError, match=r"message|multiple|bytes"):
        decode_step(encode_step(episode.records[3])[:-cut] if cut < 100 else b"\x12\x05hello")


def test_varint_is_that_of_the_library():
    for value in (0, 1, 127, 128, 300, 2**32, 2**63):
        assert b"\x08" + varint(value) == Step(step=value).SerializeToString() or value == 0


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("tip", np.zeros(2), r"tip must have shape \(3,\)"),
        ("wire_points", np.zeros(6), r"wire_points must have shape \(n, 3\)"),
        ("contact_forces", np.zeros((9, 3)), "3 positions and 9 forces"),
        ("step", -1, "step must lie in 0 to 1000000"),
    ],
)
def test_record_refuses_wrong_shapes(episode, name, value, message):
    with pytest.raises(ValueError, match=message):
        replace(episode.records[3], **{name: value})


def test_force_norm_is_that_of_its_vector(episode):
    assert replace(episode.records[0], resultant_force=np.array([2.0, -3.0, 6.0])).resultant_force_norm == 7.0
