"""The reader of episode logs: streaming, random access by step, and stacked arrays, all with checksums verified."""

from __future__ import annotations

import os
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator
from functools import cached_property, partial
from itertools import zip_longest
from operator import itemgetter
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from google.protobuf.message import DecodeError
from mcap.records import ChunkIndex
from numpy.typing import NDArray

from pipeline.episodes.arrays import stacked
from pipeline.episodes.camera import Camera, camera_frame
from pipeline.episodes.encoding import scan
from pipeline.episodes.encoding.png import decode_image, decode_mask
from pipeline.episodes.encoding.scene import PhantomMesh, decode_phantom
from pipeline.episodes.encoding.schema import (
    DEVICES_TOPIC,
    EPISODE_METADATA,
    OUTCOME_METADATA,
    PHANTOM_TOPIC,
    STEP_TOPIC,
    camera_topic,
    topic_messages,
)
from pipeline.episodes.encoding.step_codec import decode_step
from pipeline.episodes.records import (
    MOST_STEPS,
    ContainerError,
    EpisodeOutcome,
    EpisodeReadError,
    StepRecord,
    VersionError,
    damaged,
    open_episode,
    open_outcome,
)
from pipeline.settings.kinds import shown

_Decoded = TypeVar("_Decoded")


class EpisodeReader:
    """Reads one finished episode; memory is bounded by a chunk, never by the file.

    What reads raises an `EpisodeReadError` where the log is damaged or holds no such step, topic or camera.

    with EpisodeReader("episode.mcap") as log:
        for record in log:
            ...
        image = log.image("frontal", 17)
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Open a log; an EpisodeReadError says that it is missing, damaged, unfinished, no episode log, or too new."""
        self.path = Path(path)
        self._fd = scan.open_log(self.path)
        try:
            self.summary = scan.read_summary(self._fd)  # the container's index
            self.info, self._cameras = self._metadata(EPISODE_METADATA, open_episode)
            self.outcome: EpisodeOutcome = self._metadata(OUTCOME_METADATA, open_outcome)
            self._topics = self._channels()
        except (ContainerError, OSError) as error:
            self.close()
            raise damaged(self.path, error) from error
        in_time = sorted(self.summary.chunk_indexes, key=lambda index: index.message_start_time)
        self._chunks: dict[int, list[ChunkIndex]] = {
            channel_id: [index for index in in_time if channel_id in index.message_index_offsets]
            for channel_id in self._topics.values()
        }
        steps = self._chunks.get(self._topics.get(STEP_TOPIC, 0), [])
        ends = [(index.message_end_time - self.info.start_time_ns) // self.info.interval_ns for index in steps]
        if not all(-1 <= end <= MOST_STEPS for end in ends):
            self.close()
            raise damaged(self.path, f"the times of its steps do not fit its start, {self.info.start_time_ns} ns")
        self._cached: tuple[int, bytes, dict[tuple[int, int], scan.MessageSpan]] = (-1, b"", {})

    def _metadata(self, name: str, parse: Callable[[dict[str, str]], _Decoded]) -> _Decoded:
        """Read the intact metadata records of a name, which must all say the same."""
        failure: ContainerError = VersionError(
            f"it has no metadata record {name}, so it was not written as an episode log"
        )
        records: list[tuple[dict[str, str], _Decoded]] = []
        for index in self.summary.metadata_indexes:
            if index.name == name:
                try:
                    record = scan.read_metadata(self._fd, index).metadata
                    records.append((record, parse(record)))
                except ContainerError as error:
                    failure = error
        if not records:
            raise failure
        if any(record != records[0][0] for record, _ in records):
            raise ContainerError(f"its metadata records {name} say different things")
        return records[0][1]

    def _channels(self) -> dict[str, int]:
        """The channel of each topic, whose messages must be of the kind that the topic has."""
        kinds = topic_messages(self.cameras, devices=self.info.has_catheter)
        topics: dict[str, int] = {}
        for channel in self.summary.channels.values():
            schema = self.summary.schemas.get(channel.schema_id)
            declaration = (channel.message_encoding, schema and schema.encoding, schema and schema.name)
            kind = kinds.get(channel.topic)
            if kind is not None and declaration != ("protobuf", "protobuf", kind.DESCRIPTOR.full_name):
                raise ContainerError(f"its messages on {channel.topic} are no {kind.DESCRIPTOR.full_name}")
            if channel.topic in topics:
                raise ContainerError(f"it has two channels of the topic {shown(channel.topic)}")
            topics[channel.topic] = channel.id
        return topics

    # -- chunks and messages ------------------------------------------------------------------------------------------

    def _channel(self, topic: str) -> int:
        channel_id = self._topics.get(topic)
        if channel_id is None or not self._chunks[channel_id]:
            held = ", ".join(sorted(topic for topic, channel in self._topics.items() if self._chunks[channel]))
            raise EpisodeReadError(f"{self.path} holds nothing on {topic}; it holds {held or 'no messages'}")
        return channel_id

    def _spans(self, index: ChunkIndex) -> tuple[bytes, dict[tuple[int, int], scan.MessageSpan]]:
        """Read a chunk, or take it from the one-chunk cache, and find its messages by channel and time."""
        offset, chunk, spans = self._cached
        where = f"the chunk at byte {index.chunk_start_offset}"
        if offset != index.chunk_start_offset:
            try:
                chunk = scan.read_chunk(self._fd, index)
                messages = list(scan.messages(chunk))
                spans = {(span.channel_id, span.log_time_ns): span for span in messages}
                if len(spans) < len(messages):
                    raise ContainerError(f"{where} has two messages of one topic and time")
                if {channel_id for channel_id, _ in spans} != set(index.message_index_offsets):
                    raise ContainerError(f"{where} has messages of other topics than the index says")
                times = [time_ns for _, time_ns in spans] or [index.message_start_time, index.message_end_time]
                if (min(times), max(times)) != (index.message_start_time, index.message_end_time):
                    raise ContainerError(f"{where} has messages of other times than the index says")
            except (ContainerError, OSError) as error:
                raise damaged(self.path, error) from error
            self._cached = (index.chunk_start_offset, chunk, spans)
        return chunk, spans

    def payloads(self, topic: str) -> Iterator[tuple[int, bytes]]:
        """Stream log time (ns) and bytes of the messages of a topic, e.g. `/step`, by their times, all different."""
        channel_id, last_ns = self._channel(topic), -1
        chunks, waiting = self._chunks[channel_id], list[tuple[int, bytes]]()
        for index, following in zip_longest(chunks, chunks[1:]):
            chunk, spans = self._spans(index)
            waiting += [(one.log_time_ns, chunk[one.start : one.end]) for one in spans.values() if one[0] == channel_id]
            waiting.sort(key=itemgetter(0))
            # what comes before all that follows: chunks are in the order of their first times, but may overlap
            ready = len(waiting) if following is None else bisect_left(waiting, (following.message_start_time,))
            for time_ns, payload in waiting[:ready]:
                if time_ns == last_ns:
                    raise damaged(self.path, f"it has two messages on {topic} at {time_ns} ns")
                last_ns = time_ns
                yield time_ns, payload
            del waiting[:ready]

    def _steps(self, topic: str) -> Iterator[tuple[int, bytes]]:
        """Stream the messages of a topic with the index of the step at whose time each stands."""
        for time_ns, payload in self.payloads(topic):
            yield self._step_at(topic, time_ns), payload

    def _step_at(self, topic: str, time_ns: int) -> int:
        step, beside = divmod(time_ns - self.info.start_time_ns, self.info.interval_ns)
        if beside or step < 0:
            raise damaged(self.path, f"a message on {topic} has log time {time_ns}, which is that of no step")
        return step

    def _payload(self, topic: str, step: int) -> bytes:
        """Find the message of a step by its time."""
        channel_id, time_ns = self._channel(topic), self.info.time_ns(step)
        chunks = self._chunks[channel_id]
        begun = bisect_right(chunks, time_ns, key=lambda index: index.message_start_time)
        for index in reversed(chunks[:begun]):
            if index.message_end_time >= time_ns:
                chunk, spans = self._spans(index)
                if span := spans.get((channel_id, time_ns)):
                    return chunk[span.start : span.end]
        if step in self.outcome.missing_steps:
            raise EpisodeReadError(f"step {step} of {self.path} was lost before the log was recovered; skip it")
        raise EpisodeReadError(f"{self.path} has no step {step} on {topic}; it holds steps 0 to {self.last_step}")

    def _decode(self, decode: Callable[[bytes], _Decoded], payload: bytes) -> _Decoded:
        try:
            return decode(payload)
        except (ValueError, DecodeError) as error:
            raise damaged(self.path, error) from error

    # -- steps --------------------------------------------------------------------------------------------------------

    @cached_property
    def last_step(self) -> int:
        """Index of the last step (-1 if there is none)."""
        channel_id, last_ns = self._topics.get(STEP_TOPIC, 0), -1
        for index in sorted(self._chunks.get(channel_id, []), key=lambda index: -index.message_end_time):
            if index.message_end_time > last_ns:  # else it holds nothing later
                last_ns = max(last_ns, *(time for channel, time in self._spans(index)[1] if channel == channel_id))
        return -1 if last_ns < 0 else self._step_at(STEP_TOPIC, last_ns)

    def __len__(self) -> int:
        """Count the records, from the state after reset to the last step."""
        return self.last_step + 1 - sum(step <= self.last_step for step in self.outcome.missing_steps)

    def __iter__(self) -> Iterator[StepRecord]:
        """Stream the records in order; a gap that the log does not own to is damage."""
        lost = set(self.outcome.missing_steps)
        expected = (step for step in range(self.outcome.steps + 1) if step not in lost)
        for step, payload in self._steps(STEP_TOPIC):
            if step != (next_step := next(expected, None)):
                instead = "beyond its end" if next_step is None else f"instead of step {next_step}"
                raise damaged(self.path, f"it has a record of step {step} {instead}")
            yield self._step(payload, step)
        if (next_step := next(expected, None)) is not None:
            raise damaged(self.path, f"it has no record of step {next_step} of {self.outcome.steps}")

    def step(self, step: int) -> StepRecord:
        """Read one step at random."""
        return self._step(self._payload(STEP_TOPIC, step), step)

    def _step(self, payload: bytes, step: int) -> StepRecord:
        """Decode a step, in a log with a catheter together with both devices."""
        devices = self._payload(DEVICES_TOPIC, step) if self.info.has_catheter else None
        record = self._decode(partial(decode_step, devices=devices), payload)
        if record.step != step:
            raise damaged(self.path, f"at the time of step {step} stands step {record.step}")
        return record

    # -- cameras and scene --------------------------------------------------------------------------------------------

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras."""
        return tuple(self._cameras)

    def camera(self, name: str) -> Camera:
        """Give a camera's calibration, every bit as written."""
        if name not in self._cameras:
            known = ", ".join(self._cameras) or "none"
            raise EpisodeReadError(f"{self.path} has no camera {name!r}; its cameras are: {known}")
        return self._cameras[name]

    def image(self, camera: str, step: int) -> NDArray[np.uint8]:
        """Read one image at random, (H, W) uint8."""
        return self._picture(camera, "image", step)

    def mask(self, camera: str, step: int, device: str | None = None) -> NDArray[np.bool_]:
        """Read one mask at random, (H, W) bool, of "wire" or "catheter" where there is one; None: of all devices."""
        return self._picture(camera, _mask_stream(device), step)

    def images(self, camera: str) -> Iterator[NDArray[np.uint8]]:
        """Stream the images of a camera, (H, W) uint8, one a step; raises as `image` does."""
        return (picture for _, picture in self.pictures(camera, "image"))

    def masks(self, camera: str, device: str | None = None) -> Iterator[NDArray[np.bool_]]:
        """Stream the masks of a camera, (H, W) bool, one a step; arguments and errors are those of `mask`."""
        return (picture for _, picture in self.pictures(camera, _mask_stream(device)))

    def pictures(self, camera: str, stream: str) -> Iterator[tuple[int, NDArray[Any]]]:
        """Stream step and picture of a camera's "image", "mask", "mask_wire" or "mask_catheter"."""
        for step, payload in self._steps(self._stream(camera, stream)):
            yield step, self._picture(camera, stream, step, payload)

    def _picture(self, camera: str, stream: str, step: int, payload: bytes | None = None) -> NDArray[Any]:
        """Decode a picture, which must say itself of which camera and time it is."""
        if payload is None:
            payload = self._payload(self._stream(camera, stream), step)

        def decode(payload: bytes) -> NDArray[Any]:
            message, size = CompressedImage.FromString(payload), (self.camera(camera).height, self.camera(camera).width)
            header = (message.timestamp.ToNanoseconds(), message.frame_id, message.format)
            if header != (self.info.time_ns(step), camera_frame(camera), "png"):
                raise ValueError(f"the {stream} of camera {camera} at step {step} is of another time, camera or format")
            return (decode_image if stream == "image" else decode_mask)(message.data, *size)

        return self._decode(decode, payload)

    def _stream(self, camera: str, stream: str) -> str:
        """Name the topic of a camera's stream; refuse a camera that there is not."""
        self.camera(camera)
        return camera_topic(camera, stream)

    def holds(self, topic: str) -> bool:
        """Say whether there are messages on a topic."""
        return bool(self._chunks.get(self._topics.get(topic, 0)))

    def has(self, camera: str, stream: str) -> bool:
        """Say whether a camera's stream, as of `pictures`, holds any."""
        return self.holds(camera_topic(camera, stream))

    def phantom_mesh(self) -> PhantomMesh | None:
        """Read the phantom's wall, target and entry; None if the log was written without."""
        if not self.holds(PHANTOM_TOPIC):
            return None
        _, payload = next(self.payloads(PHANTOM_TOPIC))
        return self._decode(decode_phantom, payload)

    # -- the whole episode --------------------------------------------------------------------------------------------

    def load_arrays(self, *, pictures: bool = True) -> dict[str, NDArray[Any]]:
        """Stack the whole episode into arrays.

        Args:
            pictures: also stack images and masks.

        Returns:
            By field name, first axis = records: `step` and `time_s` (T,), `action` (T, a), ...; `wire_points`,
            `contact_positions` and `contact_forces` are padded with NaN to the largest count, the counts being
            `wire_count` and `contact_count` (T,); with a catheter `devices/insertions` (T, 2) and so on, with
            `devices/wire_count` and `devices/catheter_count`; extra scalars as `extra/<key>` (NaN where absent);
            pictures as `image/<camera>` (T, H, W) uint8 and `mask/<camera>` (T, H, W) bool, with a catheter also
            `mask_wire/<camera>` and `mask_catheter/<camera>`.
        """
        return stacked(self, pictures=pictures)

    def close(self) -> None:
        """Close the file; closing again does nothing."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def __enter__(self) -> EpisodeReader:
        return self

    def __exit__(self, *unused: object) -> None:
        self.close()


def _mask_stream(device: str | None) -> str:
    return "mask" if device is None else f"mask_{device}"
