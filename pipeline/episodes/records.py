"""What an episode log holds: a step, the episode's information and its outcome; their metadata records; and the errors.

A metadata record is JSON with its checksum and version.
"""

from __future__ import annotations

import json
import math
import time
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Le, Lt
from numpy.typing import NDArray
from pydantic import BeforeValidator, ConfigDict, ValidationError
from pydantic.dataclasses import dataclass as validated
from pydantic_core import from_json

from pipeline.episodes.camera import Camera, require_name
from pipeline.episodes.encoding.schema import EPISODE_METADATA, SCHEMA_VERSION
from pipeline.printing import written
from pipeline.settings.kinds import sentence, shown
from pipeline.store.errors import PipelineError
from pipeline.store.provenance import hash_value


class EpisodeWriteError(PipelineError, OSError):
    """A log cannot be written; what was flushed before is safe in its partial file."""


class EpisodeReadError(PipelineError, ValueError):
    """A log cannot be read, because it is damaged, foreign or too new."""


class ContainerError(ValueError):
    """A part of an MCAP file is damaged; the message is the reason alone, without file name or advice."""


def damaged(path: Path, reason: object) -> EpisodeReadError:
    """Make the error of a damaged log, or of a file that is no log or is too new."""
    if isinstance(reason, VersionError):
        return EpisodeReadError(f"{path} cannot be read: {reason}")
    return EpisodeReadError(f"{path} is damaged: {reason}; run '{recover_command(path)}' to save what is intact")


def recover_command(path: Path) -> str:
    """Give the command line that recovers a log."""
    return f"{written('episodes')} recover {path}"


FloatArray = NDArray[np.float64]

MOST_STEPS = 1_000_000
"""Of an episode: 28 hours at ten steps a second. A log that claims more is damaged, not long."""

# Arrays of a step, and their length where it is known.
_VECTORS = {"action": None, "joint_positions": None, "joint_velocities": None, "tip": 3, "resultant_force": 3}
_PAIRS = ("insertions", "hub_rotations", "tip_rotations", "feeder_forces", "hub_torques")
_CHECKED = ConfigDict(allow_inf_nan=False, extra="forbid")
_Step = Annotated[int, Ge(0), Le(MOST_STEPS)]
_Truth = Annotated[bool, BeforeValidator(lambda value: bool(value) if isinstance(value, np.bool_) else value)]


def _vector(name: str, value: Any, length: int | None) -> FloatArray:
    array = np.array(value, dtype=np.float64, order="C")
    if array.ndim != 1 or (length is not None and array.shape[0] != length):
        expected = "(n,)" if length is None else f"({length},)"
        raise ValueError(f"{name} must have shape {expected}, got {np.shape(value)}")
    return array


def _points(name: str, value: Any) -> FloatArray:
    array = np.array(value, dtype=np.float64, order="C")
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name} must have shape (n, 3), got {np.shape(value)}; no points is np.zeros((0, 3))")
    return array


@dataclass(frozen=True, eq=False, kw_only=True, slots=True)
class DeviceRecord:
    """Wire and catheter in a step; pairs are wire, then catheter. Arrays are copied."""

    wire_points: FloatArray  # (n, 3), m, world, from the wire's tip; (0, 3) where there is none
    catheter_points: FloatArray  # (m, 3), m, world, from the catheter's tip
    insertions: FloatArray  # (2,), m
    hub_rotations: FloatArray  # (2,), rad
    tip_rotations: FloatArray  # (2,), rad; NaN of a wire that there is not
    lead: float  # m, of the wire's tip before the catheter's; negative: withdrawn into it
    feeder_forces: FloatArray  # (2,), N, what the feeders push with
    hub_torques: FloatArray  # (2,), N m, by which the hubs are held

    def __post_init__(self) -> None:
        for name in _PAIRS:
            object.__setattr__(self, name, _vector(name, getattr(self, name), 2))
        for name in ("wire_points", "catheter_points"):
            object.__setattr__(self, name, _points(name, getattr(self, name)))


@dataclass(frozen=True, eq=False, kw_only=True, slots=True)
class StepRecord:
    """One step of an episode: the action, and the reward and the state that followed it.

    Record 0 is the state after reset; its action is what the producer calls "none" (zeros) and its reward is 0.
    Arrays are copied, as simulators like to give views of what the next step overwrites.
    Non-finite numbers are kept, so that a diverged run can be looked at; `check` reports them.
    """

    step: int
    action: FloatArray  # (a,), as given to the environment
    reward: float
    terminated: bool
    truncated: bool
    joint_positions: FloatArray  # (q,), m or rad
    joint_velocities: FloatArray  # (v,), m/s or rad/s
    wire_points: FloatArray  # (n, 3), m, world, tip first; with a catheter, of the rod that both devices are
    tip: FloatArray  # (3,), m, world
    contact_positions: FloatArray  # (k, 3), m, world
    contact_forces: FloatArray  # (k, 3), N, world
    resultant_force: FloatArray  # (3,), N, world: the largest resultant of the contact forces over the step
    insertion: float  # m
    rotation: float  # rad
    extra: Mapping[str, float] = field(default_factory=dict)  # further scalars, unit in the name
    devices: DeviceRecord | None = None  # both devices; None in a log of the wire without a catheter

    def __post_init__(self) -> None:
        if not 0 <= self.step <= MOST_STEPS:
            raise ValueError(f"step must lie in 0 to {MOST_STEPS}, got {self.step}")
        for name, length in _VECTORS.items():
            object.__setattr__(self, name, _vector(name, getattr(self, name), length))
        for name in ("wire_points", "contact_positions", "contact_forces"):
            object.__setattr__(self, name, _points(name, getattr(self, name)))
        if len(self.contact_positions) != len(self.contact_forces):
            raise ValueError(
                f"every contact needs a position and a force, got {len(self.contact_positions)} positions "
                f"and {len(self.contact_forces)} forces"
            )

    @property
    def resultant_force_norm(self) -> float:
        """Norm of `resultant_force`, N."""
        x, y, z = self.resultant_force.tolist()
        return math.sqrt(x * x + y * y + z * z)


def _plain(value: Any) -> Any:
    """Turn numpy scalars and arrays, paths and sets into what JSON knows."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, set | frozenset):
        return sorted(value)
    return str(value)


def _finite(value: Any) -> Any:
    """Replace non-finite numbers by None: JSON has no NaN."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value


def as_json(value: Any) -> str:
    """Serialise plain values as strict JSON; numpy values become lists, non-finite numbers null."""
    plain = json.loads(json.dumps(value, default=_plain))
    return json.dumps(_finite(plain), sort_keys=True, allow_nan=False)


def catheter_name(configuration: Mapping[str, Any]) -> str:
    """The preset of a configuration's catheter; one of a file is told from others by six digits of its values' hash."""
    return str(configuration.get("catheter_preset") or f"own catheter {hash_value(configuration['catheter'])[:6]}")


@validated(frozen=True, kw_only=True, config=_CHECKED)
class EpisodeInfo:
    """What is known of an episode before its first step."""

    phantom: str
    phantom_hash: str
    target: str
    entry: str
    seed: int
    operator: str  # who steered: a policy's name, "sampling_expert", "human", ...
    control_dt: Annotated[float, Ge(1e-9), Le(3600)]  # s, from one step to the next
    start_time_ns: Annotated[int, Ge(0), Lt(2**62)] = field(default_factory=time.time_ns)  # nanoseconds since the epoch
    configuration: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, Any] = field(default_factory=dict)  # software -> version

    def __post_init__(self) -> None:
        # What is kept is what a reader will give back: plain JSON values.
        object.__setattr__(self, "configuration", json.loads(as_json(self.configuration)))
        object.__setattr__(self, "versions", {str(key): str(value) for key, value in self.versions.items()})

    @property
    def has_catheter(self) -> bool:
        """Whether a catheter was there, so that every step has `devices`."""
        return self.configuration.get("catheter") is not None

    @property
    def catheter_name(self) -> str:
        """The catheter's name as `catheter_name` gives it, "" where there was none."""
        return catheter_name(self.configuration) if self.has_catheter else ""

    @property
    def interval_ns(self) -> int:
        """Nanoseconds from one step to the next."""
        return round(self.control_dt * 1e9)

    def time_ns(self, step: int) -> int:
        """Give the log time of a step."""
        return self.start_time_ns + step * self.interval_ns


OUTCOME_STATES = ("finished", "interrupted")


@validated(frozen=True, kw_only=True, config=_CHECKED)
class EpisodeOutcome:
    """How an episode ended."""

    success: _Truth | None  # None: not known
    steps: _Step  # actions taken: one less than the records, as record 0 is the state after reset
    # numbers, strings or None; a non-finite number becomes None
    metrics: Mapping[str, Any] = field(default_factory=dict)
    status: str = "finished"  # "finished", or "interrupted" for a log whose writer was stopped
    # steps that a recovery found missing between the first and the last one, rising
    missing_steps: tuple[_Step, ...] = ()

    def __post_init__(self) -> None:
        if self.status not in OUTCOME_STATES:
            raise ValueError(f"status must be one of {', '.join(OUTCOME_STATES)}, got {self.status!r}")
        if any(later <= step for step, later in pairwise(self.missing_steps)):
            raise ValueError("missing_steps must rise")
        object.__setattr__(self, "metrics", json.loads(as_json(self.metrics)))


_LONGEST_REASON = 200


class VersionError(ContainerError):
    """The record has no schema version, or one that this reader does not know."""


def _checksum(schema_version: str, text: str) -> str:
    return f"{zlib.crc32(f'{schema_version} {text}'.encode()):08x}"


def seal(values: Mapping[str, Any]) -> dict[str, str]:
    """Make the content of a metadata record of plain values: JSON with its checksum and the schema version."""
    text, schema_version = as_json(values), str(SCHEMA_VERSION)
    return {"schema_version": schema_version, "json": text, "crc32": _checksum(schema_version, text)}


def unseal(record: Mapping[str, str]) -> dict[str, Any]:
    """Read the values of a metadata record; a VersionError where its schema version is missing or too new."""
    if "schema_version" not in record:
        raise VersionError("it has no schema version, so it was not written as an episode log")
    schema_version = record["schema_version"]
    text = record.get("json", "")
    if record.get("crc32") != _checksum(schema_version, text):
        raise ContainerError("the checksum of its metadata does not match")
    if schema_version not in map(str, range(1, SCHEMA_VERSION + 1)):
        version = shown(schema_version)[1:-1]
        raise VersionError(
            f"it has schema version {version}, this reader knows up to {SCHEMA_VERSION}: update the software"
        )
    try:
        # unlike the standard library's, this parser ends at 200 levels and refuses halves of surrogate pairs
        values = from_json(text, allow_inf_nan=False)
    except ValueError as error:
        raise ContainerError(f"its metadata is no JSON that can be read ({error})") from error
    if not isinstance(values, dict):
        raise ContainerError("its metadata is no JSON object")
    return values


def seal_episode(info: EpisodeInfo, cameras: Mapping[str, Camera]) -> dict[str, str]:
    """Make the content of the record `endonav.episode`."""
    ordered = [{"name": name, **camera.to_json()} for name, camera in cameras.items()]
    return seal({"info": asdict(info), "cameras": ordered})


def open_episode(record: Mapping[str, str]) -> tuple[EpisodeInfo, dict[str, Camera]]:
    """Read the record `endonav.episode`: information, and cameras by name in their order; raises as `unseal` does."""
    values = unseal(record)
    try:
        cameras: dict[str, Camera] = {}
        for camera_values in values["cameras"]:
            name, camera = require_name(camera_values["name"]), Camera.from_json(camera_values)
            if name in cameras:
                raise ValueError(f"two cameras have the name {shown(name)}")
            _require_as_written(camera_values, {"name": name, **camera.to_json()})
            cameras[name] = camera
        info = EpisodeInfo(**values["info"])
        _require_as_written(values["info"], asdict(info))
        return info, cameras
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ContainerError(f"the metadata record {EPISODE_METADATA} cannot be used ({_reason(error)})") from error


def _require_as_written(values: Mapping[str, Any], understood: Mapping[str, Any]) -> None:
    """Refuse values that a writer writes otherwise, such as a truth in words, which a validator takes for the same."""
    for name, value in values.items():
        if name not in understood:
            raise ValueError(f"{shown(name)} is no field")
        if as_json(value) != as_json(understood[name]):
            raise ValueError(f"{name} must be {shown(understood[name])}, got {shown(value)}")


def _reason(error: Exception) -> str:
    if isinstance(error, ValidationError):
        return sentence(error, "")[:_LONGEST_REASON]
    return f"{error} is missing" if isinstance(error, KeyError) else " ".join(str(error).split())[:_LONGEST_REASON]


def seal_outcome(outcome: EpisodeOutcome) -> dict[str, str]:
    """Make the content of the record `endonav.outcome`."""
    return seal(asdict(outcome))


def open_outcome(record: Mapping[str, str]) -> EpisodeOutcome:
    """Read the content of the record `endonav.outcome`; raises as `unseal` does."""
    values = unseal(record)
    try:
        outcome = EpisodeOutcome(**values)
        _require_as_written(values, asdict(outcome))
        return outcome
    except (TypeError, ValueError, OverflowError) as error:
        raise ContainerError(f"the episode's outcome cannot be used ({_reason(error)})") from error
