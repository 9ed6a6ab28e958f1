"""The reader of episode logs: streaming, random access by step, and stacked arrays, all with checksums verified."""

from __future__ import annotations

import os
from bisect import bisect_left
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from google.protobuf.message import DecodeError
from mcap.records import ChunkIndex
from numpy.typing import NDArray

from pipeline.episodes.camera import Camera
from pipeline.episodes.encoding.png import decode_image, decode_mask
from pipeline.episodes.encoding.scan import MessageSpan, Summary, messages, read_chunk, read_metadata, read_summary
from pipeline.episodes.encoding.scene import PhantomMesh, decode_phantom
from pipeline.episodes.encoding.schema import (
    DEVICE_FIELDS,
    DEVICES_TOPIC,
    EPISODE_METADATA,
    OUTCOME_METADATA,
    PHANTOM_TOPIC,
    STEP_FIELDS,
    STEP_TOPIC,
    camera_topic,
)
from pipeline.episodes.encoding.step_codec import decode_step
from pipeline.episodes.errors import ContainerError, EpisodeReadError, damaged
from pipeline.episodes.metadata import VersionError, open_episode, open_outcome
from pipeline.episodes.records import MOST_STEPS, EpisodeOutcome, StepRecord

_Decoded = TypeVar("_Decoded")
_MOST_POINTS = 1 << 26  # of a ragged field stacked over an episode: 1.5 GB
_RAGGED = {
    "wire_points": "wire_count",
    "contact_positions": "contact_count",
    "contact_forces": "contact_count",
    "devices/wire_points": "devices/wire_count",
    "devices/catheter_points": "devices/catheter_count",
}


class EpisodeReader:
    """Reads one finished episode; memory is bounded by a chunk, never by the file.

    What reads raises an `EpisodeReadError` where the log is damaged or holds no such step, topic or camera.

    with EpisodeReader("episode.mcap") as log:
        for record in log:
            ...
        image = log.image("frontal", 17)
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Open a log.

        Raises:
            EpisodeReadError: it is missing, damaged, unfinished, no episode log, or newer than this reader.
        """
        self.path = Path(path)
        try:
            self._fd = os.open(self.path, os.O_RDONLY | os.O_CLOEXEC)
        except OSError as error:
            raise EpisodeReadError(f"cannot open {self.path}: {error.strerror}; check the path") from error
        try:
            self._summary = read_summary(self._fd)
            self.info, self._cameras = self._metadata(EPISODE_METADATA, open_episode)
            self.outcome: EpisodeOutcome = self._metadata(OUTCOME_METADATA, open_outcome)
        except VersionError as error:
            self.close()
            raise EpisodeReadError(f"{self.path} cannot be read: {error}") from error
        except (ContainerError, OSError) as error:
            self.close()
            raise damaged(self.path, error) from error
        self._topics = {channel.topic: channel.id for channel in self._summary.channels.values()}
        self._chunks: dict[int, list[ChunkIndex]] = {
            channel_id: [index for index in self._summary.chunk_indexes if channel_id in index.message_index_offsets]
            for channel_id in self._topics.values()
        }
        self._ends = {key: [index.message_end_time for index in chunks] for key, chunks in self._chunks.items()}
        if not -1 <= self.last_step <= MOST_STEPS:
            self.close()
            raise damaged(self.path, f"the times of its steps do not fit its start, {self.info.start_time_ns} ns")
        self._cached: tuple[int, bytes, dict[tuple[int, int], MessageSpan]] = (-1, b"", {})

    def _metadata(self, name: str, parse: Callable[[dict[str, str]], _Decoded]) -> _Decoded:
        """Read the first intact one of the metadata records of a name."""
        failure: ContainerError = VersionError(
            f"it has no metadata record {name}, so it was not written as an episode log"
        )
        for index in self._summary.metadata_indexes:
            if index.name == name:
                try:
                    return parse(read_metadata(self._fd, index).metadata)
                except ContainerError as error:
                    failure = error
        raise failure

    # -- chunks and messages ------------------------------------------------------------------------------------------

    @property
    def summary(self) -> Summary:
        """The container's index."""
        return self._summary

    def _channel(self, topic: str) -> int:
        channel_id = self._topics.get(topic)
        if channel_id is None or not self._chunks[channel_id]:
            held = ", ".join(sorted(topic for topic, channel in self._topics.items() if self._chunks[channel]))
            raise EpisodeReadError(f"{self.path} holds nothing on {topic}; it holds {held or 'no messages'}")
        return channel_id

    def _spans(self, index: ChunkIndex) -> tuple[bytes, dict[tuple[int, int], MessageSpan]]:
        """Read a chunk, or take it from the one-chunk cache, and find its messages by channel and time."""
        offset, chunk, spans = self._cached
        if offset != index.chunk_start_offset:
            try:
                chunk = read_chunk(self._fd, index)
                spans = {(span.channel_id, span.log_time_ns): span for span in messages(chunk)}
            except (ContainerError, OSError) as error:
                raise damaged(self.path, error) from error
            self._cached = (index.chunk_start_offset, chunk, spans)
        return chunk, spans

    def payloads(self, topic: str) -> Iterator[tuple[int, bytes]]:
        """Stream the messages of a topic.

        Args:
            topic: e.g. `/step`.

        Yields:
            Log time in nanoseconds, and the serialised message.
        """
        channel_id = self._channel(topic)
        for index in self._chunks[channel_id]:
            chunk, spans = self._spans(index)
            for span in spans.values():
                if span.channel_id == channel_id:
                    yield span.log_time_ns, chunk[span.start : span.end]

    def _payload(self, topic: str, step: int) -> bytes:
        """Find the message of a step by its time."""
        channel_id, time_ns = self._channel(topic), self.info.time_ns(step)
        chunks = self._chunks[channel_id]
        for index in chunks[bisect_left(self._ends[channel_id], time_ns) :]:
            if index.message_start_time > time_ns:
                break
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

    @property
    def last_step(self) -> int:
        """Index of the last step (-1 if there is none)."""
        ends = self._ends.get(self._topics.get(STEP_TOPIC, 0), [])
        return (ends[-1] - self.info.start_time_ns) // self.info.interval_ns if ends else -1

    def __len__(self) -> int:
        """Count the records, from the state after reset to the last step."""
        return self.last_step + 1 - sum(step <= self.last_step for step in self.outcome.missing_steps)

    def __iter__(self) -> Iterator[StepRecord]:
        """Stream the records in order."""
        for time_ns, payload in self.payloads(STEP_TOPIC):
            step = (time_ns - self.info.start_time_ns) // self.info.interval_ns
            yield self._step(payload, step)

    def step(self, step: int) -> StepRecord:
        """Read one step at random."""
        return self._step(self._payload(STEP_TOPIC, step), step)

    def _step(self, payload: bytes, step: int) -> StepRecord:
        """Decode a step, in a log with a catheter together with both devices."""
        devices = self._payload(DEVICES_TOPIC, step) if self.info.has_catheter else None
        return self._decode(partial(decode_step, devices=devices), payload)

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
        return self._decode(_image, self._payload(self._stream(camera, "image"), step))

    def mask(self, camera: str, step: int, device: str | None = None) -> NDArray[np.bool_]:
        """Read one mask at random, (H, W) bool.

        Args:
            device: "wire" or "catheter", in a log with a catheter; None: of all devices.
        """
        return self._decode(_mask, self._payload(self._stream(camera, _mask_stream(device)), step))

    def images(self, camera: str) -> Iterator[NDArray[np.uint8]]:
        """Stream the images of a camera, (H, W) uint8, one a step; raises as `image` does."""
        return (self._decode(_image, payload) for _, payload in self.payloads(self._stream(camera, "image")))

    def masks(self, camera: str, device: str | None = None) -> Iterator[NDArray[np.bool_]]:
        """Stream the masks of a camera, (H, W) bool, one a step; arguments and errors are those of `mask`."""
        stream = self._stream(camera, _mask_stream(device))
        return (self._decode(_mask, payload) for _, payload in self.payloads(stream))

    def _stream(self, camera: str, stream: str) -> str:
        """Name the topic of a camera's stream; refuse a camera that there is not."""
        self.camera(camera)
        return camera_topic(camera, stream)

    def has(self, camera: str, stream: str) -> bool:
        """Say whether a camera's stream holds pictures.

        Args:
            stream: "image", "mask", "mask_wire" or "mask_catheter".
        """
        return bool(self._chunks.get(self._topics.get(camera_topic(camera, stream), 0)))

    def phantom_mesh(self) -> PhantomMesh | None:
        """Read the phantom's wall, target and entry; None if the log was written without."""
        if not self._chunks.get(self._topics.get(PHANTOM_TOPIC, 0)):
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
        records = list(self)
        if not records:
            raise damaged(self.path, "it holds no step")
        steps = np.array([record.step for record in records], dtype=np.int64)
        arrays: dict[str, NDArray[Any]] = {"step": steps}
        arrays["time_s"] = steps * self.info.interval_ns * 1e-9
        stacked = {name: [getattr(record, name) for record in records] for name in STEP_FIELDS if name != "step"}
        if self.info.has_catheter:
            of_devices = [name for name in DEVICE_FIELDS if name != "step"]
            stacked |= {f"devices/{name}": [getattr(one.devices, name) for one in records] for name in of_devices}
        for name, values in stacked.items():
            if name in _RAGGED:
                counts = np.array([len(value) for value in values])
                if counts.max() * len(values) > _MOST_POINTS:
                    raise damaged(self.path, f"a step holds {counts.max()} {name}, too many to stack {len(values)}")
                padded = np.full((len(values), counts.max(), 3), np.nan)
                for row, value in zip(padded, values, strict=True):
                    row[: len(value)] = value
                arrays[name], arrays[_RAGGED[name]] = padded, counts
            else:
                arrays[name] = self._stack(name, [np.asarray(value) for value in values])
        for key in dict.fromkeys(key for record in records for key in record.extra):
            arrays[f"extra/{key}"] = np.array([record.extra.get(key, np.nan) for record in records])
        for camera in self._cameras if pictures else ():
            readers: dict[str, Callable[[str], Iterator[NDArray[Any]]]] = {"image": self.images, "mask": self.masks}
            readers |= {_mask_stream(device): partial(self.masks, device=device) for device in ("wire", "catheter")}
            for stream, pictures_of in readers.items():
                if self.has(camera, stream):
                    arrays[f"{stream}/{camera}"] = self._stack(f"{stream} of camera {camera}", [*pictures_of(camera)])
        return arrays

    def _stack(self, name: str, values: list[NDArray[Any]]) -> NDArray[Any]:
        """Stack what must be of one shape."""
        if not values:
            raise damaged(self.path, f"it holds no {name}")
        shapes = dict.fromkeys(value.shape for value in values)
        if len(shapes) > 1:
            raise damaged(self.path, f"{name} changes its shape from step to step: {', '.join(map(str, shapes))}"[:300])
        return np.stack(values)

    def close(self) -> None:
        """Close the file; closing again does nothing."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def __enter__(self) -> EpisodeReader:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


def _image(message: bytes) -> NDArray[np.uint8]:
    return decode_image(CompressedImage.FromString(message).data)


def _mask_stream(device: str | None) -> str:
    return "mask" if device is None else f"mask_{device}"


def _mask(message: bytes) -> NDArray[np.bool_]:
    return decode_mask(CompressedImage.FromString(message).data)
