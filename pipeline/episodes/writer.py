"""The writer of episode logs: a context manager whose finished file is whole and whose killed file can be recovered."""

from __future__ import annotations

import errno
import logging
import os
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from mcap_protobuf.schema import build_file_descriptor_set
from numpy.typing import NDArray

from pipeline.episodes.camera import Camera, camera_frame, require_name
from pipeline.episodes.encoding import schema
from pipeline.episodes.encoding.container import MAX_CHUNK_BYTES, McapFile, is_being_written
from pipeline.episodes.encoding.png import encode_image, encode_mask
from pipeline.episodes.encoding.scene import PhantomMesh, encode_wire_line, encode_wire_points
from pipeline.episodes.encoding.step_codec import encode_devices, encode_step
from pipeline.episodes.records import (
    EpisodeInfo,
    EpisodeOutcome,
    EpisodeWriteError,
    StepRecord,
    recover_command,
    seal_episode,
    seal_outcome,
)

logger = logging.getLogger(__name__)

MAX_FLUSH_EVERY = 10
"""A killed writer may lose at most so many steps."""

_DISK_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_IMAGE_TYPES = (np.dtype(np.uint8),)
_MASK_TYPES = (np.dtype(np.bool_), np.dtype(np.uint8))
_STREAMS = ("image", "mask")
_Picture = tuple[str, str, Callable[[Any], bytes], NDArray[Any]]  # topic, camera, encoder, pixels


@cache
def schema_data(message: Any) -> bytes:
    """Serialise the schema that MCAP wants of a protobuf message: a FileDescriptorSet with all dependencies."""
    return bytes(build_file_descriptor_set(message).SerializeToString())


def register_topics(file: McapFile, cameras: Iterable[str], *, devices: bool) -> dict[str, int]:
    """Declare a log's topics in the order of the schema; give the channel of each."""
    messages = schema.topic_messages(tuple(cameras), devices=devices)
    return {topic: file.register(topic, one.DESCRIPTOR.full_name, schema_data(one)) for topic, one in messages.items()}


class EpisodeWriter:
    """Writes one episode.

    The log grows in `<path>.partial` and moves to `path` in one instant when it is finished. Every `flush_every` steps
    the chunk goes to the operating system, so that a kill at any moment loses fewer steps than that; `recover` makes a
    valid log of the rest.

        with EpisodeWriter("episode.mcap", info, cameras={"frontal": camera}) as log:
            log.step(record, images={"frontal": image}, masks={"frontal": mask})
            log.finish(EpisodeOutcome(success=True, steps=0))

    Leaving the block without `finish` finishes the log with an unknown success; leaving it by an exception keeps the
    partial file as it is.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        info: EpisodeInfo,
        *,
        cameras: Mapping[str, Camera] | None = None,
        phantom_mesh: PhantomMesh | None = None,
        flush_every: int = 8,
        overwrite: bool = False,
    ) -> None:
        """Start a log.

        Args:
            path: the finished log; folders are made.
            cameras: cameras by name; each may give an image and a mask at every step.
            flush_every: steps from flush to flush, 1 to 10.
            overwrite: replace an existing log or partial log instead of refusing.

        Raises:
            ValueError: `flush_every` is out of range, or a camera's name is no word.
            EpisodeWriteError: there is such a log already, or the file cannot be written.
        """
        if not 1 <= flush_every <= MAX_FLUSH_EVERY:
            raise ValueError(f"flush_every must be 1 to {MAX_FLUSH_EVERY} steps, got {flush_every}")
        self.path = Path(path)
        self.partial = self.path.with_name(f"{self.path.name}.partial")
        self.info = info
        self.cameras = {require_name(name): camera for name, camera in (cameras or {}).items()}
        self._flush_every = flush_every
        self.steps_recorded = 0
        self.steps_safe = 0  # that a kill of the process cannot take any more
        self._state: Literal["open", "finished", "abandoned"] = "open"
        self._outcome_written = False
        self._pending: deque[tuple[StepRecord, list[_Picture]]] = deque()
        self._streams: tuple[tuple[str, ...], ...] = ()
        self._shapes: tuple[tuple[int, ...], ...] = ()
        self._overwrite = overwrite
        self._require_free()
        if overwrite and is_being_written(self.partial):
            raise EpisodeWriteError(f"another writer is at work on {self.partial}: choose another name")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise EpisodeWriteError(
                f"cannot make {self.path.parent}: {error.strerror}; choose another folder"
            ) from error
        try:
            if overwrite:
                self.partial.unlink(missing_ok=True)
            self._file = McapFile(self.partial)
        except FileExistsError:
            raise EpisodeWriteError(
                f"{self.partial} exists already, from a writer that is at work or was killed: run "
                f"'{recover_command(self.partial)}' and delete it, or pass overwrite=True"
            ) from None
        except OSError as error:
            raise EpisodeWriteError(f"cannot write {self.partial}: {error.strerror}; choose another folder") from error
        self._channels = register_topics(self._file, self.cameras, devices=info.has_catheter)
        try:
            self._begin(phantom_mesh)
        except OSError as error:
            self._file.close()
            self.partial.unlink(missing_ok=True)  # it holds no step, and would only be in the way of the next try
            raise self._write_error(error) from error

    def _require_free(self) -> None:
        if self.path.exists() and not self._overwrite:
            raise EpisodeWriteError(f"{self.path} exists already: choose another name, or pass overwrite=True")

    def _begin(self, phantom_mesh: PhantomMesh | None) -> None:
        """Write what stands once at the beginning."""
        sealed = seal_episode(self.info, self.cameras)
        for _ in range(2):  # twice: see the schema
            self._file.add_metadata(schema.EPISODE_METADATA, sealed)
        time_ns = self.info.start_time_ns
        if self.cameras:
            transforms = [camera.transform(name, time_ns) for name, camera in self.cameras.items()]
            message = FrameTransforms(transforms=transforms).SerializeToString()
            self._file.add(self._channels[schema.TRANSFORM_TOPIC], time_ns, 0, message)
        for name, camera in self.cameras.items():
            topic = schema.camera_topic(name, "calibration")
            self._file.add(self._channels[topic], time_ns, 0, camera.calibration(name, time_ns))
        if phantom_mesh is not None:
            self._file.add(self._channels[schema.PHANTOM_TOPIC], time_ns, 0, phantom_mesh.scene(time_ns))
        self._file.flush()

    def step(
        self,
        record: StepRecord,
        *,
        images: Mapping[str, NDArray[np.uint8]] | None = None,
        masks: Mapping[str, NDArray[np.bool_] | NDArray[np.uint8]] | None = None,
        device_masks: Mapping[str, Mapping[str, NDArray[np.bool_] | NDArray[np.uint8]]] | None = None,
    ) -> None:
        """Record a step.

        Args:
            record: the step; steps are consecutive, and record 0 is the state after reset.
            images: (H, W) uint8 by camera; the same cameras at every step.
            masks: (H, W) bool, or uint8 with wire = not 0, by camera; the same cameras at every step.
            device_masks: "wire" or "catheter" to such masks, in a log with a catheter; the same at every step.

        Raises:
            ValueError: the step does not continue the episode; nothing of it is recorded.
            EpisodeWriteError: the disk is full or failed; the steps flushed before are safe in the partial file.
        """
        if self._state != "open":
            raise EpisodeWriteError(f"{self.path} is {self._state}: start a new writer for a new episode")
        images, masks = images or {}, masks or {}
        beside = {f"mask_{device}": dict(one) for device, one in (device_masks or {}).items()}
        self._check(record, {"image": images, "mask": masks, **beside})
        pictures: list[_Picture] = []
        pictures += [(f"/camera/{name}/image", name, encode_image, image.copy()) for name, image in images.items()]
        pictures += [
            (schema.camera_topic(name, stream), name, encode_mask, mask.copy())
            for stream, one in (("mask", masks), *beside.items())
            for name, mask in one.items()
        ]
        self._pending.append((record, pictures))
        self.steps_recorded += 1
        if self.steps_recorded - self.steps_safe >= self._flush_every:
            try:
                self._flush()
            except OSError as error:
                raise self._write_error(error) from error

    def _flush(self) -> None:
        """Encode what is pending and hand it to the operating system.

        Several steps are encoded in a row because that is faster than one between two steps of a simulator, which leave
        the processor's caches cold.
        """
        while self._pending:
            batch = self._encode(*self._pending[0])
            size = sum(len(payload) for _, payload in batch) + 64 * len(batch)
            if self._file.pending_bytes and self._file.pending_bytes + size > MAX_CHUNK_BYTES:
                self._file.flush()
                self.steps_safe = self.steps_recorded - len(self._pending)
            record, _ = self._pending.popleft()
            time_ns = self.info.time_ns(record.step)
            for channel_id, payload in batch:
                self._file.add(channel_id, time_ns, record.step, payload)
        self._file.flush()
        self.steps_safe = self.steps_recorded

    def _encode(self, record: StepRecord, pictures: list[_Picture]) -> list[tuple[int, bytes]]:
        """Serialise a step as messages with their channels."""
        time_ns, channels = self.info.time_ns(record.step), self._channels
        devices = record.devices
        wire = record.wire_points if devices is None else devices.wire_points
        batch = [
            (channels[schema.STEP_TOPIC], encode_step(record)),
            (channels[schema.WIRE_TOPIC], encode_wire_line(wire, time_ns)),
            (channels[schema.WIRE_POINTS_TOPIC], encode_wire_points(wire, time_ns)),
        ]
        if devices is not None:
            catheter = devices.catheter_points
            batch += [
                (channels[schema.DEVICES_TOPIC], encode_devices(record.step, devices)),
                (channels[schema.CATHETER_TOPIC], encode_wire_line(catheter, time_ns, "catheter")),
                (channels[schema.CATHETER_POINTS_TOPIC], encode_wire_points(catheter, time_ns)),
            ]
        for topic, camera, encode, picture in pictures:
            message = CompressedImage(frame_id=camera_frame(camera), format="png", data=encode(picture))
            message.timestamp.FromNanoseconds(time_ns)
            batch.append((channels[topic], message.SerializeToString()))
        return batch

    def _check(self, record: StepRecord, pictures: Mapping[str, Mapping[str, Any]]) -> None:
        """Refuse a step that would make a log nobody can stack into arrays."""
        if record.step != self.steps_recorded:
            raise ValueError(f"expected step {self.steps_recorded}, got {record.step}: steps are consecutive, from 0")
        if (record.devices is not None) != self.info.has_catheter:
            raise ValueError(
                "a step has devices just where the configuration of its log names a catheter: got "
                f"{'none' if record.devices is None else 'devices'} in step {record.step}"
            )
        for stream, arrays in pictures.items():
            if stream not in (*_STREAMS, *(schema.DEVICE_MASKS if self.info.has_catheter else ())):
                raise ValueError(f"a log without a catheter has no {stream}: give its mask alone")
            types = _IMAGE_TYPES if stream == "image" else _MASK_TYPES
            for name, array in arrays.items():
                camera = self.cameras.get(name)
                if camera is None:
                    known = ", ".join(self.cameras) or "none"
                    raise ValueError(f"camera {name!r} was not declared; the cameras of this log are: {known}")
                if array.shape != (camera.height, camera.width) or array.dtype not in types:
                    raise ValueError(
                        f"the {stream} of camera {name!r} must be {types[0]} of shape "
                        f"({camera.height}, {camera.width}), got {array.dtype} of shape {array.shape}"
                    )
        streams = tuple(tuple(arrays) for arrays in pictures.values())
        shapes = (record.action.shape, record.joint_positions.shape, record.joint_velocities.shape)
        if self.steps_recorded == 0:
            self._streams, self._shapes = streams, shapes
        if streams != self._streams:
            raise ValueError(
                f"every step needs the images and masks of step 0, {self._streams}, in this order, got {streams}"
            )
        if shapes != self._shapes:
            raise ValueError(
                f"step {record.step} must have action, joint_positions and joint_velocities of the shapes of step 0, "
                f"{self._shapes}, got {shapes}"
            )

    def _write_error(self, error: OSError) -> EpisodeWriteError:
        cause = "disk full" if error.errno in _DISK_FULL else f"{error.strerror or error}"
        if not self.steps_recorded:
            return EpisodeWriteError(
                f"{cause} while writing {self.path} before its first step: free space, start again"
            )
        return EpisodeWriteError(
            f"{cause} while writing {self.path}: {self.steps_safe} of {self.steps_recorded} steps are safe in "
            f"{self.partial}; free space and run '{recover_command(self.partial)}'"
        )

    def finish(self, outcome: EpisodeOutcome | None = None) -> Path:
        """Write the outcome and the index, and move the log to its name; finishing again does nothing.

        Args:
            outcome: how the episode ended; None for an unknown success.

        Raises:
            ValueError: the outcome counts other steps than were recorded; the log stays open.
            EpisodeWriteError: the disk is full or failed, which may be tried again; or the writer was abandoned.
        """
        if self._state == "finished":
            return self.path
        if self._state == "abandoned":
            raise EpisodeWriteError(f"{self.path} was abandoned: run '{recover_command(self.partial)}'")
        taken = max(self.steps_recorded - 1, 0)
        outcome = outcome or EpisodeOutcome(success=None, steps=taken)
        if outcome.steps != taken:
            raise ValueError(
                f"the outcome must count {taken} steps, as {self.steps_recorded} records from the reset on were "
                f"written, got {outcome.steps}"
            )
        self._require_free()  # of a log that came meanwhile
        if not self._file.closed and not self._file.in_place:
            raise EpisodeWriteError(f"{self.partial} was removed or replaced while it was written: its steps are lost")
        try:
            self._flush()
            if not self._outcome_written:
                self._file.add_metadata(schema.OUTCOME_METADATA, seal_outcome(outcome))
                self._outcome_written = True
            if not self._file.closed:
                self._file.close_with_index()
            os.replace(self.partial, self.path)
        except OSError as error:
            raise self._write_error(error) from error
        self._state = "finished"
        return self.path

    def abandon(self) -> None:
        """Close without finishing: what was recorded stays in the partial file for `recover`."""
        if self._state != "open":
            return
        self._state = "abandoned"
        ours = self._file.closed or self._file.in_place  # the partial file is not another's by now
        try:
            if not self._file.closed:
                self._flush()
        except OSError as error:
            logger.warning("%s", self._write_error(error))
        self._file.close()
        if not ours:
            logger.warning("%s was removed or replaced while it was written: its steps are lost", self.partial)
            return
        if not self.steps_recorded:
            self.partial.unlink(missing_ok=True)  # it holds no step, and would only be in the way of the next try
            return
        logger.warning(
            "%s was not finished; %d steps are in %s: run '%s'",
            self.path,
            self.steps_safe,
            self.partial,
            recover_command(self.partial),
        )

    def __enter__(self) -> EpisodeWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, *unused: object) -> None:
        try:
            if kind is None:
                self.finish()
        finally:
            if self._state == "open":
                self.abandon()
