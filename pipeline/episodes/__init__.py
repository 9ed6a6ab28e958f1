"""Episode logs: one MCAP file an episode, written safely, read by step, checked and recovered."""

from pipeline.episodes.camera import Camera
from pipeline.episodes.checking import CheckReport, check
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
    ViewerError,
)
from pipeline.episodes.recovery import RecoveryReport, recover
from pipeline.episodes.writer import EpisodeWriter

__all__ = [
    "SCHEMA_VERSION",
    "Camera",
    "CheckReport",
    "DeviceRecord",
    "EpisodeInfo",
    "EpisodeOutcome",
    "EpisodeReadError",
    "EpisodeReader",
    "EpisodeWriteError",
    "EpisodeWriter",
    "PhantomMesh",
    "RecoveryReport",
    "StepRecord",
    "ViewerError",
    "check",
    "recover",
]
