"""The check of a log: every checksum, every step, every picture."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from mcap.records import DataEnd

from pipeline.episodes.encoding.scan import check_magic, messages, open_chunk, parse_record, walk
from pipeline.episodes.encoding.schema import DEVICE_FIELDS, DEVICES_TOPIC, STEP_FIELDS, STEP_TOPIC
from pipeline.episodes.encoding.step_codec import decode_devices, decode_with_norm
from pipeline.episodes.errors import ContainerError, EpisodeReadError, damaged
from pipeline.episodes.reader import EpisodeReader
from pipeline.episodes.recover import mapped

_MAGIC_BYTES = 8
_MAX_PROBLEMS = 20


@dataclass
class CheckReport:
    """What a check found."""

    path: Path
    records: int = 0
    pictures: int = 0
    problems: list[str] = field(default_factory=list)
    """one sentence each; empty if the log is fine"""
    notes: list[str] = field(default_factory=list)
    """what is known to be incomplete without being damaged"""


def check(path: Path) -> CheckReport:
    """Check a log from its first byte to its last; damage is reported, never raised."""
    report = CheckReport(path)
    try:
        _check_data_section(path)
        with EpisodeReader(path) as log:
            _check_steps(log, report)
            if log.info.has_catheter:
                _check_devices(log, report)
            _check_pictures(log, report)
            _check_statistics(log, report)
            if log.phantom_mesh() is None:
                report.notes.append("no phantom mesh")
            if log.outcome.status != "finished":
                report.notes.append("the episode was interrupted")
            if log.outcome.missing_steps:
                report.notes.append(f"{len(log.outcome.missing_steps)} steps were lost before recovery")
    except EpisodeReadError as error:
        report.problems.append(str(error))
    return report


def _check_data_section(path: Path) -> None:
    """Verify the checksums of the data section and of all its chunks."""
    with mapped(path) as (fd, data):
        try:
            check_magic(fd)
            crc = zlib.crc32(data[:_MAGIC_BYTES])
            for opcode, start, end in walk(data, _MAGIC_BYTES):
                if opcode == Opcode.DATA_END:
                    expected = parse_record(DataEnd, data[start:end]).data_section_crc
                    if expected not in (0, crc):
                        raise ContainerError("the checksum of its data section does not match")
                    return
                record = data[start - 9 : end]
                crc = zlib.crc32(record, crc)
                if opcode == Opcode.CHUNK:
                    for _ in messages(open_chunk(record[9:], start - 9)):
                        pass
            raise ContainerError("its data section has no end, so its writer was stopped or the file was cut off")
        except ContainerError as error:
            raise damaged(path, error) from error


def _add(report: CheckReport, problem: str) -> None:
    if len(report.problems) < _MAX_PROBLEMS:
        report.problems.append(problem)


def _check_steps(log: EpisodeReader, report: CheckReport) -> None:
    """Verify that steps follow each other, stand at their time and hold finite numbers."""
    missing = set(log.outcome.missing_steps)
    expected, shapes = 0, None
    for time_ns, payload in log.payloads(STEP_TOPIC):
        try:
            record, norm = decode_with_norm(payload)
        except ValueError as error:
            _add(report, f"the record after step {expected - 1} cannot be decoded: {error}")
            expected += 1
            continue
        while expected in missing:
            expected += 1
        if record.step != expected:
            _add(report, f"step {expected} was expected, step {record.step} stands there")
        expected = record.step + 1
        if time_ns != log.info.time_ns(record.step):
            _add(report, f"step {record.step} has log time {time_ns}, expected {log.info.time_ns(record.step)}")
        for name in STEP_FIELDS:
            if not np.isfinite(getattr(record, name)).all():
                _add(report, f"step {record.step} has a non-finite number in {name}")
        for key, value in record.extra.items():
            if not np.isfinite(value):
                _add(report, f"step {record.step} has a non-finite number in extra {key}")
        if not np.isclose(norm, record.resultant_force_norm, rtol=1e-9, atol=1e-12, equal_nan=True):
            _add(report, f"step {record.step} has force norm {norm}, its vector {record.resultant_force_norm}")
        found = (record.action.shape, record.joint_positions.shape, record.joint_velocities.shape)
        shapes = shapes or found
        if found != shapes:
            _add(report, f"step {record.step} has shapes {found}, the first record {shapes}")
        report.records += 1
    while expected in missing:
        expected += 1
    if expected - 1 != log.outcome.steps:
        _add(report, f"the outcome counts {log.outcome.steps} steps, the records {expected - 1}")


def _check_devices(log: EpisodeReader, report: CheckReport) -> None:
    """Verify that every record has both devices, at its time and with finite numbers."""
    count = 0
    for time_ns, payload in log.payloads(DEVICES_TOPIC):
        count += 1
        try:
            step, devices = decode_devices(payload)
        except ValueError as error:
            _add(report, f"the devices of record {count - 1} cannot be decoded: {error}")
            continue
        if time_ns != log.info.time_ns(step):
            _add(report, f"the devices of step {step} have log time {time_ns}, expected {log.info.time_ns(step)}")
        there = np.array([len(devices.wire_points), len(devices.catheter_points)]) > 0
        for name in DEVICE_FIELDS:
            value = np.asarray(getattr(devices, name, step))
            if not np.isfinite(value[there] if name == "tip_rotations" else value).all():
                _add(report, f"step {step} has a non-finite number in {name} of its devices")
    if count != report.records:
        _add(report, f"there are devices of {count} steps for {report.records} records")


def _check_pictures(log: EpisodeReader, report: CheckReport) -> None:
    """Verify that every stream has one picture a record, of the camera's size."""
    for name in log.cameras:
        size = (log.camera(name).height, log.camera(name).width)
        streams: dict[str, Callable[[str], Iterable[Any]]] = {"image": log.images, "mask": log.masks}
        for device in ("wire", "catheter") if log.info.has_catheter else ():
            streams[f"mask_{device}"] = partial(log.masks, device=device)
        for stream, pictures in streams.items():
            if not log.has(name, stream):
                report.notes.append(f"no {stream} of camera {name}")
                continue
            count = 0
            for picture in pictures(name):
                count += 1
                if picture.shape != size:
                    _add(report, f"{stream} {count - 1} of camera {name} is {picture.shape}, expected {size}")
            if count != report.records:
                _add(report, f"camera {name} has {count} {stream}s for {report.records} records")
            report.pictures += count


def _check_statistics(log: EpisodeReader, report: CheckReport) -> None:
    """Verify that the index counts what is there."""
    statistics = log.summary.statistics
    if statistics is None:
        return
    for channel in log.summary.channels.values():
        if channel.topic == STEP_TOPIC and statistics.channel_message_counts.get(channel.id, 0) != report.records:
            counted = statistics.channel_message_counts.get(channel.id, 0)
            _add(report, f"the index counts {counted} records, there are {report.records}")
