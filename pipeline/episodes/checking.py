"""The check of a log: every checksum, every step, every picture, and that all topics are of the same steps."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, DataEnd, MessageIndex, Schema

from pipeline.episodes.encoding import schema
from pipeline.episodes.encoding.scan import MessageSpan, check_magic, messages, open_chunk, parse_record, walk
from pipeline.episodes.reader import EpisodeReader
from pipeline.episodes.records import ContainerError, EpisodeReadError, damaged
from pipeline.episodes.recovery import mapped

_MAGIC_BYTES = 8
_MAX_PROBLEMS = 20


@dataclass
class CheckReport:
    """What a check found."""

    records: int = 0
    pictures: int = 0
    problems: list[str] = field(default_factory=list)  # one sentence each; empty if the log is fine
    notes: list[str] = field(default_factory=list)  # what is known to be incomplete without being damaged


@dataclass
class _DataSection:
    """What stands before the index."""

    chunks: set[int] = field(default_factory=set)
    metadata: int = 0
    declared: list[Any] = field(default_factory=list)  # schemas and channels, each as often as it stands there


def check(path: Path) -> CheckReport:
    """Check a log from its first byte to its last; damage is reported, never raised."""
    report = CheckReport()
    try:
        with mapped(path) as (fd, data):
            try:
                check_magic(fd)
                section = _read_data_section(data)
            except ContainerError as error:
                raise damaged(path, error) from error
        with EpisodeReader(path) as log:
            _check_index(log, section, report)
            _check_times(log, _check_records(log, report), report)
            _check_pictures(log, report)
            mesh = log.phantom_mesh()
            if mesh is None:
                report.notes.append("no phantom mesh")
            elif not all(np.isfinite(points).all() for points in (mesh.vertices, mesh.target, mesh.entry)):
                _add(report, "the phantom has a point that is not finite")
            if log.outcome.status != "finished":
                report.notes.append("the episode was interrupted")
            if log.outcome.missing_steps:
                report.notes.append(f"{len(log.outcome.missing_steps)} steps were lost before recovery")
    except EpisodeReadError as error:
        report.problems.append(str(error))
    return report


def _add(report: CheckReport, problem: str) -> None:
    if len(report.problems) < _MAX_PROBLEMS:
        report.problems.append(problem)


def _read_data_section(data: Any) -> _DataSection:
    """Verify the checksums of the data section and of all its chunks, and that it holds what a log may hold."""
    section, crc = _DataSection(), zlib.crc32(data[:_MAGIC_BYTES])
    expected: dict[int, list[MessageSpan]] = {}
    for opcode, start, end in walk(data, _MAGIC_BYTES):
        content = data[start:end]
        if opcode == Opcode.DATA_END:
            if parse_record(DataEnd, content).data_section_crc not in (0, crc):
                raise ContainerError("the checksum of its data section does not match")
            return section
        crc = zlib.crc32(content, zlib.crc32(data[start - 9 : start], crc))
        if opcode == Opcode.CHUNK:
            chunk = open_chunk(content, start - 9)
            section.chunks.add(start - 9)
            expected = {}
            for span in messages(chunk):
                expected.setdefault(span.channel_id, []).append(span)
            for inner, begin, stop in walk(chunk):
                _keep_declaration(section, inner, chunk[begin:stop])
        elif opcode == Opcode.MESSAGE_INDEX:
            index = parse_record(MessageIndex, content)
            spans = expected.get(index.channel_id, [])
            if sorted(index.records) != sorted((span.log_time_ns, span.record_start) for span in spans):
                raise ContainerError(f"the index of messages at byte {start - 9} does not fit its chunk")
        elif opcode == Opcode.METADATA:
            section.metadata += 1
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            _keep_declaration(section, opcode, content)
        elif opcode != Opcode.HEADER:
            raise ContainerError(f"the record at byte {start - 9} is of kind {opcode}, which a log does not hold")
    raise ContainerError("its data section has no end, so its writer was stopped or the file was cut off")


def _keep_declaration(section: _DataSection, opcode: int, content: bytes) -> None:
    if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
        section.declared.append(parse_record(Schema if opcode == Opcode.SCHEMA else Channel, content))


def _check_index(log: EpisodeReader, section: _DataSection, report: CheckReport) -> None:
    """Verify that the index at the end names all that stands before it, and declares the same."""
    summary = log.summary
    if {index.chunk_start_offset for index in summary.chunk_indexes} != section.chunks:
        _add(report, "the index does not name the chunks that are there")
    if len(summary.metadata_indexes) != section.metadata:
        _add(report, f"the index names {len(summary.metadata_indexes)} metadata records of {section.metadata}")
    for one in section.declared:
        if one != (summary.schemas if isinstance(one, Schema) else summary.channels).get(one.id):
            _add(report, f"the index declares {type(one).__name__.lower()} {one.id} otherwise than the data section")


def _check_records(log: EpisodeReader, report: CheckReport) -> list[int]:
    """Verify that the records, which the reader finds in order and at their times, hold finite numbers; give steps."""
    steps: list[int] = []
    shapes = None
    for record in log:
        for name in schema.STEP_FIELDS:
            if not np.isfinite(getattr(record, name)).all():
                _add(report, f"step {record.step} has a non-finite number in {name}")
        for key, value in record.extra.items():
            if not np.isfinite(value):
                _add(report, f"step {record.step} has a non-finite number in extra {key}")
        if (devices := record.devices) is not None:
            present = np.array([len(devices.wire_points), len(devices.catheter_points)]) > 0
            for name in schema.DEVICE_FIELDS:
                numbers = np.asarray(getattr(devices, name, record.step))
                if not np.isfinite(numbers[present] if name == "tip_rotations" else numbers).all():
                    _add(report, f"step {record.step} has a non-finite number in {name} of its devices")
        record_shapes = (record.action.shape, record.joint_positions.shape, record.joint_velocities.shape)
        shapes = shapes or record_shapes
        if record_shapes != shapes:
            _add(report, f"step {record.step} has shapes {record_shapes}, the first record {shapes}")
        steps.append(record.step)
    report.records = len(steps)
    return steps


def _check_times(log: EpisodeReader, steps: Sequence[int], report: CheckReport) -> None:
    """Verify that every topic has a message for each record, or one at the start, and that the index counts them."""
    once = {
        schema.PHANTOM_TOPIC,
        schema.TRANSFORM_TOPIC,
        *(schema.camera_topic(name, "calibration") for name in log.cameras),
    }
    every_step = [log.info.time_ns(step) for step in steps]
    counts = log.summary.statistics.channel_message_counts if log.summary.statistics else None
    for channel in log.summary.channels.values():
        times = [time_ns for time_ns, _ in log.payloads(channel.topic)] if log.holds(channel.topic) else []
        if counts is not None and counts.get(channel.id, 0) != len(times):
            _add(report, f"the index counts {counts.get(channel.id, 0)} messages on {channel.topic}, not {len(times)}")
        if channel.topic not in schema.topic_messages(log.cameras, devices=log.info.has_catheter):
            report.notes.append(f"the topic {channel.topic}, which this version does not know")
        elif times:
            due_times = [log.info.start_time_ns] if channel.topic in once else every_step
            pairs = enumerate(zip_longest(times, due_times))
            number = next((number for number, (one, other) in pairs if one != other), None)
            if number is not None:
                _add(report, f"{channel.topic} has {len(times)} messages for {len(due_times)}, odd from {number} on")


def _check_pictures(log: EpisodeReader, report: CheckReport) -> None:
    """Verify that every picture can be decoded, and is of the size, camera and time that it should be."""
    for name in log.cameras:
        for stream in ("image", "mask", *(schema.DEVICE_MASKS if log.info.has_catheter else ())):
            if log.has(name, stream):
                report.pictures += sum(1 for _ in log.pictures(name, stream))
            else:
                report.notes.append(f"no {stream} of camera {name}")
