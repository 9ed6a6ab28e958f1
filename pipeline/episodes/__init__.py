"""Episode logs: one MCAP file an episode, written safely and read by step; `checking` and `recovery` mend them."""

from pipeline.episodes.camera import Camera
from pipeline.episodes.encoding.scene import PhantomMesh
from pipeline.episodes.encoding.schema import SCHEMA_VERSION
from pipeline.episodes.reader import EpisodeReader
from pipeline.episodes.records import (
    DeviceRecord,
    EpisodeInfo,
    EpisodeOutcome,
    EpisodeReadError,
    EpisodeWriteError,
    StepRecord,
)
from pipeline.episodes.writer import EpisodeWriter

__all__ = [
    "SCHEMA_VERSION",
    "Camera",
    "DeviceRecord",
    "EpisodeInfo",
    "EpisodeOutcome",
    "EpisodeReadError",
    "EpisodeReader",
    "EpisodeWriteError",
    "EpisodeWriter",
    "PhantomMesh",
    "StepRecord",
]
