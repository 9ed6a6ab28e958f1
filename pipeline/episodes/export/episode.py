"""An episode as an exporter takes it: the arrays of a layout, and its pictures as a stream."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.episodes.export.layout import TWO_DEVICES, ExportError, Layout
from pipeline.episodes.reader import EpisodeReader

_MASK = "_mask"
# the translation and rotation at an action of 1, where a log's configuration has no pace
_TRANSLATION_M, _ROTATION_RAD = 0.002, float(np.radians(15.0))


@dataclass(frozen=True, eq=False)
class ExportEpisode:
    """An episode of n actions; observations and infos have n + 1 rows, the first that after reset."""

    log: EpisodeReader
    layout: Layout
    arrays: Mapping[str, NDArray[Any]]
    """everything of the log, as `EpisodeReader.load_arrays` gives it without pictures"""
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
    """Read a log for export.

    Raises:
        ExportError: a number is not finite that other formats have to hold.
        EpisodeReadError: the log is damaged.
    """
    with EpisodeReader(path) as log:
        arrays = log.load_arrays(pictures=False)
        mesh = log.phantom_mesh() if "goal" in layout.observations else None
        observations = observation_values(arrays, None if mesh is None else np.asarray(mesh.target, np.float64))
        infos = {name: info_values(name, arrays) for name in layout.infos}
        actions, rewards = arrays["action"][1:], arrays["reward"][1:]
        for name, values in {**observations, "action": actions, "reward": rewards}.items():
            if not np.isfinite(values).all():
                raise ExportError(f"{path} has a non-finite number in {name}: leave it out of the folder")
        terminated = arrays["terminated"][1:].astype(bool)
        truncated = arrays["truncated"][1:].astype(bool)
        truncated[-1] |= not terminated[-1]  # an interrupted episode was cut off there
        yield ExportEpisode(log, layout, arrays, observations, infos, actions, rewards, terminated, truncated)


def observation_values(
    arrays: Mapping[str, NDArray[Any]], goal: NDArray[np.float64] | None
) -> dict[str, NDArray[np.float64]]:
    """The observations of a layout, from the arrays of a log or of some of its records.

    Args:
        arrays: as `EpisodeReader.load_arrays` names them.
        goal: the target, (3,) m; None: the log has none.
    """
    observations = {
        "tip": arrays["tip"],
        "feeder": feeder_values(arrays),
        "force": arrays["resultant_force"],
        "joint_positions": arrays["joint_positions"],
        "joint_velocities": arrays["joint_velocities"],
    }
    return observations if goal is None else observations | {"goal": np.tile(goal, (len(arrays["tip"]), 1))}


def feeder_values(arrays: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
    """The observable `feeder` of `NavigateEnv`, from a log's arrays.

    Returns:
        Shape (n + 1, 3); of a wire in a catheter (n + 1, 7).
    """
    if arrays["action"].shape[1] != TWO_DEVICES:
        inserted, turned = arrays["insertion"][:, None], arrays["rotation"][:, None]
        return np.concatenate((inserted, np.cos(turned), np.sin(turned)), axis=1)
    inserted, turned = arrays["devices/insertions"], arrays["devices/hub_rotations"]
    parts = np.stack((inserted, np.cos(turned), np.sin(turned)), axis=2).reshape(len(inserted), 6)
    return np.concatenate((parts, arrays["devices/lead"][:, None]), axis=1)


def info_values(name: str, arrays: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
    """An info of a layout, from a log's arrays; NaN where the log lacks it."""
    own = {"force_norm": "resultant_force_norm", "insertion": "insertion", "rotation": "rotation"}
    key = own.get(name) or (f"devices/{name.removeprefix('device_')}" if name.startswith("device_") else None)
    if key is not None and key in arrays:
        return arrays[key].astype(np.float64)
    missing = np.full(len(arrays["tip"]), np.nan)
    return arrays.get(f"extra/{name}", missing).astype(np.float64)
