"""Recovery: all intact chunks of a damaged log under a new name."""

from __future__ import annotations

import logging
import mmap
import os
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema

from pipeline.episodes.camera import Camera
from pipeline.episodes.encoding import scan
from pipeline.episodes.encoding.container import McapFile, is_being_written, replacing
from pipeline.episodes.encoding.schema import EPISODE_METADATA, OUTCOME_METADATA, STEP_TOPIC
from pipeline.episodes.records import (
    MOST_STEPS,
    ContainerError,
    EpisodeInfo,
    EpisodeOutcome,
    EpisodeReadError,
    EpisodeWriteError,
    VersionError,
    open_episode,
    open_outcome,
    seal_episode,
    seal_outcome,
)
from pipeline.episodes.writer import register_topics

logger = logging.getLogger(__name__)

_MAGIC_BYTES = 8
# What reading in vain may cost, in bytes: each record walked over; in all, and beside that times the log's size.
_RECORD_COST, _MOST_IN_VAIN, _TIMES_IN_VAIN = 1 << 10, 1 << 28, 64


@dataclass(frozen=True, kw_only=True)
class RecoveryReport:
    """What a recovery saved and what it could not."""

    destination: Path
    steps_kept: int
    # steps known to be lost; a killed writer's last few steps leave no trace and are not counted
    missing_steps: tuple[int, ...]
    bytes_dropped: int  # bytes of the source from the last verified record before damage to the next one behind it
    outcome_kept: bool  # whether the outcome was intact; otherwise the log says "interrupted"


@dataclass
class _Findings:
    """What is intact in a source."""

    episode: tuple[EpisodeInfo, dict[str, Camera]] | None = None
    outcome: EpisodeOutcome | None = None
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[tuple[int, int]] = field(default_factory=list)  # where each intact chunk's content begins and ends
    bytes_dropped: int = 0
    unpacked: int = 0  # bytes of all intact chunks
    refusal: VersionError | None = None


@contextmanager
def mapped(path: Path) -> Iterator[tuple[int, Any]]:
    """Map a file into memory, which reads what is used and nothing else; gives descriptor and map."""
    with open(scan.open_log(path), "rb") as log:
        if os.fstat(log.fileno()).st_size == 0:
            raise EpisodeReadError(f"{path} is empty: there is nothing to recover")
        with mmap.mmap(log.fileno(), 0, access=mmap.ACCESS_READ) as data:
            yield log.fileno(), data


def _examine(data: Any, likely: Iterator[int]) -> _Findings:
    """Find what is intact, going on behind damaged records.

    Most records have no checksum of their own, and a wrong length may swallow what follows: after damage the search
    goes back to the end of the last record whose checksum was right. What is read in vain is limited, as every record
    of a forged log can reach over all that follow.
    """
    findings, position, verified = _Findings(), _MAGIC_BYTES, _MAGIC_BYTES
    in_vain = since_verified = 0
    while position < len(data) and in_vain <= _MOST_IN_VAIN + _TIMES_IN_VAIN * len(data):
        try:
            for opcode, start, end in scan.walk(data, position):
                position = start - 9
                since_verified += _RECORD_COST
                if opcode == Opcode.CHUNK:
                    content = data[start:end]
                    since_verified += len(content) + scan.unpacked_bytes(content)
                    findings.unpacked += len(scan.open_chunk(content, position))
                    scan.require_proportion(findings.unpacked, len(data))
                    findings.chunks.append((start, end))
                    verified, since_verified = end, 0
                elif opcode == Opcode.METADATA:
                    since_verified += end - start
                    if _keep_metadata(findings, scan.parse_record(Metadata, data[start:end])):
                        verified, since_verified = end, 0
                elif opcode == Opcode.SCHEMA:
                    schema = scan.parse_record(Schema, data[start:end])
                    findings.schemas.setdefault(schema.id, schema)
                elif opcode == Opcode.CHANNEL:
                    channel = scan.parse_record(Channel, data[start:end])
                    findings.channels.setdefault(channel.id, channel)
                elif opcode == Opcode.FOOTER and end == len(data) - _MAGIC_BYTES:
                    return findings
                elif opcode == Opcode.FOOTER or not Opcode.HEADER <= opcode <= Opcode.DATA_END:
                    raise ContainerError(f"the record at byte {position} is of no known kind")
                position = end
        except ContainerError as error:
            scan.require_proportion(findings.unpacked, len(data))
            if isinstance(error, VersionError):
                findings.refusal = error
            in_vain, since_verified = in_vain + since_verified, 0
            resumed = next((place for place in likely if place >= verified), len(data))
            logger.info("%s; %d bytes skipped", error, resumed - verified)
            findings.bytes_dropped += resumed - verified
            # Whatever stands there is either right, which moves on, or is not looked at again.
            position, verified = resumed, resumed + 1
    findings.bytes_dropped += len(data) - position if position < len(data) else 0
    return findings


def _keep_metadata(findings: _Findings, record: Metadata) -> bool:
    """Keep an episode's information or outcome; say whether it was one."""
    if record.name == EPISODE_METADATA:
        findings.episode = open_episode(record.metadata)
    elif record.name == OUTCOME_METADATA:
        findings.outcome = open_outcome(record.metadata)
    else:
        return False
    return True


def _declare(out: McapFile, findings: _Findings, info: EpisodeInfo, cameras: dict[str, Camera]) -> dict[int, int]:
    """Register the topics; return the new channel id of each old one."""
    new_ids = register_topics(out, cameras, devices=info.has_catheter)
    # A writer numbers its channels in the order of the table, so the table stands in where a record is damaged.
    renumbered = dict(enumerate(new_ids.values(), start=1))
    for channel in findings.channels.values():
        schema = findings.schemas.get(channel.schema_id)
        if channel.topic not in new_ids and channel.id not in renumbered and schema is not None:
            new_ids[channel.topic] = out.register(channel.topic, schema.name, schema.data, schema.encoding)
        if channel.topic in new_ids:
            renumbered[channel.id] = new_ids[channel.topic]
    return renumbered


def recover(
    source: str | os.PathLike[str], destination: str | os.PathLike[str], *, overwrite: bool = False
) -> RecoveryReport:
    """Save what is intact of a log.

    Args:
        source: a partial, truncated or damaged log; it is left as it is.
        destination: where the valid log goes, in one instant when it is complete.
        overwrite: replace an existing destination instead of refusing.

    Raises:
        EpisodeReadError: the source is no episode log, is too new, is being written, or holds no intact step.
        EpisodeWriteError: the destination exists, or cannot be written.
    """
    source, destination = Path(source), Path(destination)

    if destination.exists() and (not overwrite or not source.exists() or destination.samefile(source)):
        raise EpisodeWriteError(f"{destination} exists already: name another file to recover {source} into")
    with mapped(source) as (fd, data), closing(scan.likely_records(data)) as likely:
        if is_being_written(source):
            raise EpisodeReadError(f"{source} cannot be recovered: a writer is at work on it; wait until it ends")
        try:
            findings = _examine(data, likely)
        except ContainerError as error:
            raise EpisodeReadError(f"{source} cannot be recovered: {error}") from error
        try:
            summary = scan.read_summary(fd)
            findings.schemas, findings.channels = summary.schemas, summary.channels
        except ContainerError:
            pass  # no index: the records in the data section must do
        if findings.episode is None:
            reason = findings.refusal or f"it holds no intact {EPISODE_METADATA} record"
            raise EpisodeReadError(f"{source} cannot be recovered: {reason}")
        info, cameras = findings.episode
        try:
            with replacing(destination, ".recovering") as out:
                steps = _copy(data, findings, out, info, cameras)
                if not steps:
                    raise EpisodeReadError(f"{source} cannot be recovered: it holds no intact step")
                outcome = _outcome(findings.outcome, steps)
                out.add_metadata(OUTCOME_METADATA, seal_outcome(outcome))
        except OSError as error:
            raise EpisodeWriteError(
                f"cannot write {destination}: {error.strerror}; {source} is unharmed: free space, or name another "
                "file, and try again"
            ) from error
    return RecoveryReport(
        destination=destination,
        steps_kept=len(steps),
        missing_steps=outcome.missing_steps,
        bytes_dropped=findings.bytes_dropped,
        outcome_kept=findings.outcome is not None,
    )


def _copy(data: Any, findings: _Findings, out: McapFile, info: EpisodeInfo, cameras: dict[str, Camera]) -> list[int]:
    """Copy the intact messages chunk by chunk; return the steps among them."""
    renumbered = _declare(out, findings, info, cameras)
    step_channel = renumbered[1] if not findings.channels else None
    for channel in findings.channels.values():
        if channel.topic == STEP_TOPIC:
            step_channel = channel.id
    sealed = seal_episode(info, cameras)
    for _ in range(2):
        out.add_metadata(EPISODE_METADATA, sealed)
    steps: list[int] = []
    copied: set[tuple[int, int]] = set()
    for start, end in findings.chunks:
        chunk = scan.open_chunk(data[start:end], start - 9)
        for span in scan.messages(chunk):
            channel_id = renumbered.get(span.channel_id)
            if channel_id is None:
                continue
            step, beside = divmod(span.log_time_ns - info.start_time_ns, info.interval_ns)
            if beside or not 0 <= step <= MOST_STEPS:
                continue  # no time of a step: the message or the start is not what a writer wrote
            if (channel_id, step) in copied:
                continue  # the first one counts
            copied.add((channel_id, step))
            if span.channel_id == step_channel:
                steps.append(step)
            out.add(channel_id, span.log_time_ns, step, chunk[span.start : span.end])
        out.flush()
    return steps


def _outcome(outcome: EpisodeOutcome | None, steps: list[int]) -> EpisodeOutcome:
    """Give the outcome of the recovered log, with the steps that are known to be missing."""
    recovered_steps = set(steps)
    if outcome is None:
        missing = tuple(step for step in range(max(recovered_steps)) if step not in recovered_steps)
        return EpisodeOutcome(success=None, steps=max(recovered_steps), status="interrupted", missing_steps=missing)
    missing = tuple(step for step in range(outcome.steps + 1) if step not in recovered_steps)
    return replace(outcome, missing_steps=missing)
