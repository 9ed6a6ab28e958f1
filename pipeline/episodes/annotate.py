"""Annotations: what becomes known only after an episode, such as a questionnaire, added to its finished log."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mcap.records import ChunkIndex, MetadataIndex

from pipeline.episodes.encoding.container import McapFile, replacing
from pipeline.episodes.encoding.scan import messages, open_log, read_chunk, read_metadata, read_summary
from pipeline.episodes.encoding.schema import EPISODE_METADATA, OUTCOME_METADATA, PROFILE
from pipeline.episodes.errors import ContainerError, EpisodeWriteError, damaged
from pipeline.episodes.metadata import seal, unseal
from pipeline.episodes.reader import EpisodeReader


def annotation_name(key: str) -> str:
    """The metadata record of an annotation.

    Returns:
        For example `endonav.questionnaire`.

    Raises:
        ValueError: the key is no word, or the name is that of a record which every log has.
    """
    name = f"endonav.{key}"
    if not key.isidentifier() or name in (EPISODE_METADATA, OUTCOME_METADATA):
        raise ValueError(f"an annotation's key must be a word other than episode and outcome, got {key!r}")
    return name


def annotate(path: str | os.PathLike[str], key: str, values: Mapping[str, Any]) -> None:
    """Add an annotation to a finished log, or replace the one of that key; the log is exchanged in one instant.

    Raises:
        ValueError: the key is no word.
        EpisodeReadError: there is no such log, or it is damaged; it stays as it is.
        EpisodeWriteError: the new log cannot be written; the old one stays as it is.
    """
    path, name = Path(path), annotation_name(key)
    with EpisodeReader(path):
        pass  # an episode log, whole and not newer than this software
    try:
        with replacing(path, PROFILE, ".annotating") as out:
            _copy(path, out, leave_out=name)
            out.add_metadata(name, seal(values))
    except OSError as error:
        raise EpisodeWriteError(f"cannot add to {path}: {error.strerror}; the log is as it was") from error
    except ContainerError as error:
        raise damaged(path, error) from error


def _copy(path: Path, out: McapFile, *, leave_out: str) -> None:
    """Copy chunks and metadata in their order."""
    fd = open_log(path)
    try:
        summary = read_summary(fd)
        counts = dict.fromkeys(summary.channels, 0)
        renumbered = {}
        for channel in summary.channels.values():
            schema = summary.schemas.get(channel.schema_id)
            if schema is None:
                raise ContainerError(f"the schema of {channel.topic} is missing")
            renumbered[channel.id] = out.register(channel.topic, schema.name, schema.data, schema.encoding)
        parts: list[ChunkIndex | MetadataIndex] = list(summary.chunk_indexes)
        parts += [index for index in summary.metadata_indexes if index.name != leave_out]
        for part in sorted(parts, key=_offset):
            if isinstance(part, MetadataIndex):
                out.add_metadata(part.name, read_metadata(fd, part).metadata)
                continue
            chunk = read_chunk(fd, part)
            for span in messages(chunk):
                if span.channel_id not in renumbered:
                    raise ContainerError(f"a message is of channel {span.channel_id}, which is not declared")
                # sequence numbers count up along a topic, as the writer's steps do
                sequence = counts[span.channel_id]
                counts[span.channel_id] += 1
                out.add(renumbered[span.channel_id], span.log_time_ns, sequence, chunk[span.start : span.end])
            out.flush()
    finally:
        os.close(fd)


def _offset(part: ChunkIndex | MetadataIndex) -> int:
    return part.chunk_start_offset if isinstance(part, ChunkIndex) else part.offset


def read_annotation(path: str | os.PathLike[str], key: str) -> dict[str, Any] | None:
    """Read an annotation of a log: its values, or None when the log has none of that key."""
    name = annotation_name(key)
    fd = open_log(path)
    try:
        found = [index for index in read_summary(fd).metadata_indexes if index.name == name]
        return unseal(read_metadata(fd, found[-1]).metadata) if found else None
    except ContainerError as error:
        raise damaged(Path(path), error) from error
    finally:
        os.close(fd)
