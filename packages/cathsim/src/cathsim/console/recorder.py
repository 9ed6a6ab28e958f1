"""Recorders of the operator's episodes: what one must do, the plain one of this package, and how others are found."""

from __future__ import annotations

import json
import logging
import os
import re
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from cathsim.devices.shelf import catheter_preset_of
from cathsim.devices.simulation import DualSimulation
from cathsim.guidewire import preset_of
from cathsim.simulation import CONTROL_STEP

if TYPE_CHECKING:
    from cathsim.environment import NavigateEnv
    from cathsim.guidewire import Guidewire
    from cathsim.metrics import EpisodeMetrics
    from cathsim.simulation import Simulation

OPERATOR = "human"
OPERATION = ("xray_on", "injections", "force_warning")  # of a step's info, besides the environment's
_OF_BOTH = ("catheter_insertion", "catheter_rotation", "lead", "feeder_forces")  # of the info with a catheter
ENTRY_POINTS = "cathsim.recorders"  # group under which other distributions offer recorders
QUESTIONNAIRE_SUFFIX = ".questionnaire.json"

_LOGGER = logging.getLogger(__name__)


class Recorder(Protocol):
    """Keeps episodes: `start`, a `step` for each step, `finish`, then perhaps `answer`; one episode at a time.

    Nothing need be kept of an episode that gets no step. Its class has a `default_folder` and is made with a folder.

    The console adds to the environment's info of each step: `xray_on`, whether the beam was on; `injections` of
    contrast medium since the step before; `force_warning`, whether the contact force has risen to the limit. To that of
    the start: `force_limit` N, and `ends_at_force_limit`, whether the procedure ends there.
    """

    def start(self, environment: NavigateEnv, info: Mapping[str, Any], *, seed: int) -> None:
        """An episode begins: the environment has been reset with this seed and gave this info."""

    def step(
        self,
        environment: NavigateEnv,
        action: np.ndarray,
        reward: float,
        info: Mapping[str, Any],
        *,
        terminated: bool,
        truncated: bool,
    ) -> None:
        """The environment has made a step."""

    def finish(self, metrics: EpisodeMetrics | None) -> Path | None:
        """The episode is over; without metrics it was broken off. Returns its file, None if there was no step."""

    def answer(self, episode: Path, answers: Mapping[str, Any]) -> Path:
        """Keeps a questionnaire with a finished episode and returns the file it is in."""


class OperationTotals:
    """Sums up X-ray, injections and force warnings of an episode, from the info of its steps."""

    def __init__(self) -> None:
        self._sums = dict.fromkeys(OPERATION, 0)

    def add(self, info: Mapping[str, Any]) -> None:
        """Counts a step; an info without them counts nothing."""
        for name in OPERATION:
            self._sums[name] += int(info.get(name, 0))

    def metrics(self, control_step: float) -> dict[str, float]:
        """The totals of the episode: `fluoroscopy_time_s`, `injections`, `force_warnings`.

        Args:
            control_step: duration of a step, s.
        """
        on, injections, warnings = self._sums.values()
        time_s = round(on * control_step, 9)
        return {"fluoroscopy_time_s": time_s, "injections": injections, "force_warnings": warnings}


TOTALS = tuple(OperationTotals().metrics(0.0))  # their names


def episode_path(folder: Path, phantom: str, target: str, suffix: str) -> Path:
    """The next free file of a task, `<folder>/<phantom>/<target>/<NNN><suffix>`, unfinished ones counted."""
    place = folder / phantom / target
    files = place.iterdir() if place.is_dir() else ()
    numbers = [int(match.group()) for path in files if (match := re.match(r"\d+", path.name))]
    return place / f"{max(numbers, default=-1) + 1:03d}{suffix}"


def write_answers(episode: Path, answers: Mapping[str, Any]) -> Path:
    """Writes a questionnaire, as `check_answers` gave it, beside its episode; returns the JSON file."""
    path = episode.with_name(episode.stem + QUESTIONNAIRE_SUFFIX)
    temporary = path.with_name(f".writing-{path.name}")
    content = {"episode": episode.name, "operator": OPERATOR, "answers": dict(answers)}
    temporary.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    os.replace(temporary, path)
    return path


class NpzRecorder:
    """Keeps each episode as a compressed NumPy archive, written when it ends.

    Arrays: action (T, 2), reward (T,), tip (T + 1, 3) m, wire_points (T + 1, n, 3) m, force (T + 1, 3) N, insertion
    (T + 1,) m, rotation (T + 1,) rad; xray_on, injections and force_warning (T,), as of `Recorder`. `description` is
    JSON: operator, phantom and its hash, task, seed, devices, force_limit (N), ends_at_force_limit, metrics, totals
    (fluoroscopy_time_s, injections, force_warnings).

    With a catheter, action is (T, 4): translation and rotation of the wire, then of the catheter; wire_points are of
    the rod that both are, and there are also catheter_insertion, catheter_rotation and lead (T + 1,), and feeder_forces
    (T + 1, 2) N. `cathsim.devices.pair.wire_and_catheter` gives each device's points of the rod, its links (m,
    in the description's devices) and the lead.
    """

    default_folder = Path("console_episodes")

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._rows: list[dict[str, Any]] = []
        self._description: dict[str, Any] = {}
        self._totals = OperationTotals()

    def start(self, environment: NavigateEnv, info: Mapping[str, Any], *, seed: int) -> None:
        """Begins an episode."""
        self._description = {
            "operator": OPERATOR,
            "phantom": environment.phantom.name,
            "phantom_hash": environment.phantom.hash,
            "entry": environment.simulation.entry,
            "task": asdict(environment.task),
            "seed": seed,
            "devices": _devices_of(environment.simulation),
            **{name: info[name] for name in ("force_limit", "ends_at_force_limit") if name in info},
        }
        self._totals = OperationTotals()
        self._rows = [self._state(environment, info)]

    @staticmethod
    def _state(environment: NavigateEnv, info: Mapping[str, Any]) -> dict[str, Any]:
        both = {name: info[name] for name in _OF_BOTH if name in info}
        return {
            "tip": info["tip"],
            "wire_points": environment.simulation.wire_points(),
            "force": info["force_vector"],
            "insertion": info["insertion"],
            "rotation": info["rotation"],
            **both,
        }

    def step(
        self,
        environment: NavigateEnv,
        action: np.ndarray,
        reward: float,
        info: Mapping[str, Any],
        *,
        terminated: bool,
        truncated: bool,
    ) -> None:
        """Keeps a step."""
        self._totals.add(info)
        operation = {name: info[name] for name in OPERATION if name in info}
        self._rows.append({"action": action, "reward": reward, **operation, **self._state(environment, info)})

    def finish(self, metrics: EpisodeMetrics | None) -> Path | None:
        """Writes the episode."""
        rows, self._rows = self._rows, []
        if len(rows) < 2:
            return None
        task = self._description["task"]
        path = episode_path(self.folder, self._description["phantom"], task["target"], ".npz")
        path.parent.mkdir(parents=True, exist_ok=True)
        arrays = {name: np.array([row[name] for row in rows]) for name in rows[0]}
        arrays |= {name: np.array([row[name] for row in rows[1:]]) for name in rows[1] if name not in rows[0]}
        totals = self._totals.metrics(CONTROL_STEP)
        description = {**self._description, "metrics": asdict(metrics) if metrics else None, "totals": totals}
        temporary = path.with_name(f".writing-{path.name}")
        np.savez_compressed(temporary, allow_pickle=False, description=np.array(json.dumps(description)), **arrays)
        os.replace(temporary, path)
        return path

    def answer(self, episode: Path, answers: Mapping[str, Any]) -> Path:
        """Keeps a questionnaire in a JSON file beside the episode."""
        return write_answers(episode, answers)


def _devices_of(simulation: Simulation) -> dict[str, Any]:
    """Presets and settings of the devices; a device of one's own has no preset."""
    if not isinstance(simulation, DualSimulation) or simulation.pair.catheter is None:
        return {"wire": _preset(simulation.wire), "wire_settings": asdict(simulation.wire), "catheter": None}
    wire, catheter = simulation.pair.wire, simulation.pair.catheter
    return {
        "wire": _preset(wire) if wire else None,
        "wire_settings": asdict(wire) if wire else None,
        "catheter": catheter_preset_of(catheter),
        "catheter_settings": asdict(catheter),
        "links": simulation.wire.links,
    }


def _preset(wire: Guidewire) -> str | None:
    preset = preset_of(wire)
    return preset[0] if preset else None


def find_recorder() -> Any:
    """The recorder class that an installed distribution offers under `cathsim.recorders`, else `NpzRecorder`."""
    for entry in entry_points(group=ENTRY_POINTS):
        try:
            return entry.load()
        except ImportError as error:
            _LOGGER.warning("recorder %s cannot be loaded (%s): episodes are kept as .npz files", entry.name, error)
    return NpzRecorder
