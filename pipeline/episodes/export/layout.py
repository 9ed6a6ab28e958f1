"""An exported data set: its fields with shapes, units, frames and parts, and an episode as an exporter takes it.

Logs that are exported together have the same fields. Record 0 of a log is the state after reset, so an episode of n
actions has n + 1 observations; the action of index t leads from observation t to observation t + 1.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.episodes.reader import EpisodeReader
from pipeline.episodes.records import StepRecord
from pipeline.store.errors import PipelineError

TIP_MOTOR_ACTIONS = 21
TWO_DEVICES = 4  # actions of a wire in a catheter
_AXES = ("x_m", "y_m", "z_m")
_FEEDER = ("insertion_m", "rotation_cos", "rotation_sin")
FURTHER = "further scalar of the log"


class ExportError(PipelineError, ValueError):
    """Logs that cannot be exported together, or a destination that cannot be used."""


@dataclass(frozen=True)
class Field:
    """A quantity that every moment or step of the data set has."""

    shape: tuple[int, ...]
    unit: str  # of all its parts, or "mixed" where the parts' names say it
    frame: str  # "world", "device" (along and about its feeder), "image" or "" of what has none
    meaning: str
    parts: tuple[str, ...] = ()  # names of its entries; none where there are many
    source: str = ""  # the array of `EpisodeReader.load_arrays` that holds it; "": that of its name

    def describe(self) -> dict[str, Any]:
        """Give the field as JSON holds it."""
        description: dict[str, Any] = {"shape": list(self.shape), "unit": self.unit, "frame": self.frame}
        return description | {"meaning": self.meaning} | ({"parts": list(self.parts)} if self.parts else {})


@dataclass(frozen=True)
class Layout:
    """What each episode of a data set holds."""

    control_dt: float  # s, between two steps
    action: Field
    observations: Mapping[str, Field]
    infos: Mapping[str, Field]
    pictures: Mapping[str, Field] = field(default_factory=dict)  # by camera, or by camera and "_mask": (height, width)

    @property
    def fps(self) -> float:
        """Steps a second; a whole number where it is one."""
        rate = round(1.0 / self.control_dt, 6)
        return int(rate) if rate == int(rate) else rate

    def differences(self, other: Layout) -> list[str]:
        """Name the fields in which another layout differs, each with both shapes."""
        descriptions = []
        if self.control_dt != other.control_dt:
            descriptions.append(f"the control step ({self.control_dt:g} s and {other.control_dt:g} s)")
        mine, theirs = self._shapes(), other._shapes()
        for name in [*mine, *(name for name in theirs if name not in mine)]:
            if mine.get(name) != theirs.get(name):
                descriptions.append(f"{name} ({_shape_text(mine.get(name))} and {_shape_text(theirs.get(name))})")
        return descriptions

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        parts = {"action": self.action, **self.observations, **self.infos}
        return {name: one.shape for name, one in parts.items()} | {
            f"pictures of {name}": one.shape for name, one in self.pictures.items()
        }

    def with_scalars_of(self, other: Layout) -> Layout:
        """Add the further scalars that only another layout has; a log that lacks them has NaN there."""
        added = {name: one for name, one in other.infos.items() if one.meaning == FURTHER and name not in self.infos}
        return replace(self, infos={**self.infos, **added}) if added else self

    def describe(self) -> dict[str, Any]:
        """Give all fields as JSON holds them."""
        return {
            "control_step_s": self.control_dt,
            "action": self.action.describe(),
            "observations": {name: one.describe() for name, one in self.observations.items()},
            "infos": {name: one.describe() for name, one in self.infos.items()},
            "pictures": {name: one.describe() for name, one in self.pictures.items()},
        }


def _shape_text(shape: tuple[int, ...] | None) -> str:
    return "none" if shape is None else "x".join(map(str, shape)) or "one number"


def layout_of(log: EpisodeReader, *, pictures: bool = True, masks: bool = False) -> Layout:
    """Read the fields of a log, with the images and masks of its cameras if wanted, from its first record."""
    first = log.step(0)
    cameras: dict[str, Field] = {}
    for name in log.cameras if pictures else ():
        size = (log.camera(name).height, log.camera(name).width)
        if log.has(name, "image"):
            cameras[name] = Field(size, "grey, 0 to 255", "image", f"X-ray image of camera {name}")
        if masks and log.has(name, "mask"):
            cameras[f"{name}_mask"] = Field(size, "0 or 255", "image", f"pixels of the devices in camera {name}")
    mesh = log.phantom_mesh()
    return Layout(
        control_dt=log.info.control_dt,
        action=_action_field(len(first.action)),
        observations=_observation_fields(first, goal=mesh is not None),
        infos=_info_fields(first),
        pictures=cameras,
    )


def _action_field(size: int) -> Field:
    """Describe the actions of so many numbers."""
    moves: tuple[str, ...] = ("translation", "rotation")
    if size == TWO_DEVICES:
        moves = tuple(f"{device}_{move}" for device in ("wire", "catheter") for move in moves)
    elif size == TIP_MOTOR_ACTIONS:
        moves = (*(f"motor_{index}" for index in range(size - 1)), "translation")
    elif size != len(moves):
        moves = tuple(f"action_{index}" for index in range(size))
    return Field((size,), "1", "device", "commands to the feeders, -1 to 1 of a step's full movement", moves)


def _observation_fields(first: StepRecord, *, goal: bool) -> dict[str, Field]:
    """Describe the observations of a log by its first record, and the goal where the log has it."""
    feeder: tuple[str, ...] = _FEEDER
    if len(first.action) == TWO_DEVICES:
        feeder = (*(f"{device}_{part}" for device in ("wire", "catheter") for part in _FEEDER), "lead_m")
    joints = "position and rotation of the feeder and angles of the joints, distal last"
    fields = {
        "tip": Field((3,), "m", "world", "the tip", tuple(f"tip_{axis}" for axis in _AXES)),
        "feeder": Field((len(feeder),), "mixed", "device", "how far the devices are fed in and turned", feeder),
        "force": Field(
            (3,),
            "N",
            "world",
            "largest resultant of the contact forces in the step",
            ("x", "y", "z"),
            "resultant_force",
        ),
        "joint_positions": Field((len(first.joint_positions),), "m or rad", "device", joints),
        "joint_velocities": Field((len(first.joint_velocities),), "m/s or rad/s", "device", f"velocities: {joints}"),
    }
    if goal:
        fields["goal"] = Field((3,), "m", "world", "the target", tuple(f"goal_{axis}" for axis in _AXES))
    return fields


def _info_fields(first: StepRecord) -> dict[str, Field]:
    """Describe what is known of each moment beside the observations, by a log's first record."""
    norm = "norm of the largest resultant of the contact forces in the step"
    fields = {
        "force_norm": Field((), "N", "", norm, source="resultant_force_norm"),
        "insertion": Field((), "m", "device", "how far the wire is fed in, or a catheter that is alone"),
        "rotation": Field((), "rad", "device", "how far its hub is turned"),
    }
    for key in first.extra:
        fields[key] = Field((), "in the name", "", FURTHER, source=f"extra/{key}")
    if first.devices is not None:
        pair = ("wire", "catheter")
        for name, unit, meaning in (
            ("insertions", "m", "how far the devices are fed in"),
            ("hub_rotations", "rad", "how far the hubs are turned"),
            ("tip_rotations", "rad", "how far the tips are turned; NaN of an absent device"),
            ("feeder_forces", "N", "what the feeders push with"),
            ("hub_torques", "N m", "by which the hubs are held"),
        ):
            fields[f"device_{name}"] = Field((2,), unit, "device", meaning, pair, f"devices/{name}")
        meaning = "how far the wire's tip is before the catheter's"
        fields["device_lead"] = Field((), "m", "device", meaning, source="devices/lead")
    return fields


def common_layout(paths: Sequence[Path], *, pictures: bool = True, masks: bool = False) -> Layout:
    """Read the layout that all logs have; an ExportError where one differs, lacks steps, or holds no action."""
    first: Layout | None = None
    for path in paths:
        with EpisodeReader(path) as log:
            if log.outcome.missing_steps:
                raise ExportError(f"{path} lacks step {log.outcome.missing_steps[0]}: leave it out of the folder")
            if log.last_step < 1:
                raise ExportError(f"{path} holds no action: leave it out of the folder")
            layout = layout_of(log, pictures=pictures, masks=masks)
        if first is None:
            first = layout
            continue
        first, layout = first.with_scalars_of(layout), layout.with_scalars_of(first)
        different = first.differences(layout)
        if different:
            raise ExportError(
                f"{paths[0]} and {path} differ in {', '.join(different)}: export logs of one kind together, each kind "
                "from a folder of its own"
            )
    assert first is not None
    return first


_MASK = "_mask"
# the translation and rotation at an action of 1, where a log's configuration has no pace
_TRANSLATION_M, _ROTATION_RAD = 0.002, float(np.radians(15.0))


@dataclass(frozen=True, eq=False)
class ExportEpisode:
    """An episode of n actions; observations and infos have n + 1 rows, the first that after reset."""

    log: EpisodeReader
    # everything of the log, as `EpisodeReader.load_arrays` gives it without pictures
    arrays: Mapping[str, NDArray[Any]]
    observations: Mapping[str, NDArray[np.float64]]
    infos: Mapping[str, NDArray[np.float64]]
    actions: NDArray[np.float64]
    rewards: NDArray[np.float64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]

    @property
    def steps(self) -> int:
        """How many actions were taken."""
        return len(self.actions)

    @property
    def task(self) -> str:
        """What the episode asked for, in words."""
        return f"reach the {self.log.info.target} in {self.log.info.phantom}"

    @property
    def success(self) -> bool:
        """Whether the target was reached; False where that is not known."""
        return self.log.outcome.success is True

    def pictures(self, name: str) -> Iterator[NDArray[np.uint8]]:
        """Stream the pictures of a layout's name, n + 1 of (height, width) uint8; masks are 0 or 255."""
        if name in self.log.cameras:
            return self.log.images(name)
        masks = self.log.masks(name.removesuffix(_MASK))
        return (mask.astype(np.uint8) * np.uint8(255) for mask in masks)

    def describe(self) -> dict[str, Any]:
        """Give what is known of the whole episode, as JSON holds it."""
        info, outcome = self.log.info, self.log.outcome
        pace = info.configuration.get("pace") or {}
        return {
            "log": self.log.path.name,
            "task": self.task,
            "phantom": info.phantom,
            "phantom_hash": info.phantom_hash,
            "target": info.target,
            "entry": info.entry,
            "seed": info.seed,
            "operator": info.operator,
            "success": outcome.success,
            "status": outcome.status,
            "steps": self.steps,
            "metrics": dict(outcome.metrics),
            "action_at_1": {
                "translation_m": pace.get("translation", _TRANSLATION_M),
                "rotation_rad": pace.get("rotation", _ROTATION_RAD),
            },
            "catheter": info.catheter_name or None,
            "cameras": {name: self.log.camera(name).to_json() for name in self.log.cameras},
            "configuration": dict(info.configuration),
            "versions": dict(info.versions),
        }


@contextmanager
def open_episode(path: Path, layout: Layout) -> Iterator[ExportEpisode]:
    """Read a log for export; an ExportError where a number is not finite that other formats have to hold."""
    with EpisodeReader(path) as log:
        arrays = log.load_arrays(pictures=False)
        mesh = log.phantom_mesh() if "goal" in layout.observations else None
        known = {**arrays, "feeder": _feeder_values(arrays)}
        if mesh is not None:
            known["goal"] = np.tile(np.asarray(mesh.target, np.float64), (len(arrays["tip"]), 1))
        missing = np.full(len(arrays["tip"]), np.nan)  # of a further scalar that this log lacks
        observations = {name: known[one.source or name] for name, one in layout.observations.items()}
        infos = {name: known.get(one.source or name, missing).astype(np.float64) for name, one in layout.infos.items()}
        actions, rewards = arrays["action"][1:], arrays["reward"][1:]
        for name, values in {**observations, "action": actions, "reward": rewards}.items():
            if not np.isfinite(values).all():
                raise ExportError(f"{path} has a non-finite number in {name}: leave it out of the folder")
        terminated = arrays["terminated"][1:].astype(bool)
        truncated = arrays["truncated"][1:].astype(bool)
        truncated[-1] |= not terminated[-1]  # an interrupted episode was cut off there
        yield ExportEpisode(log, arrays, observations, infos, actions, rewards, terminated, truncated)


def _feeder_values(arrays: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
    """The observable `feeder` of `NavigateEnv` from a log's arrays, (n + 1, 3); of a wire in a catheter (n + 1, 7)."""
    if arrays["action"].shape[1] != TWO_DEVICES:
        inserted, turned = arrays["insertion"][:, None], arrays["rotation"][:, None]
        return np.concatenate((inserted, np.cos(turned), np.sin(turned)), axis=1)
    inserted, turned = arrays["devices/insertions"], arrays["devices/hub_rotations"]
    parts = np.stack((inserted, np.cos(turned), np.sin(turned)), axis=2).reshape(len(inserted), 6)
    return np.concatenate((parts, arrays["devices/lead"][:, None]), axis=1)
