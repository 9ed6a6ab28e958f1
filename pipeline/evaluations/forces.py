"""Contact forces read from episode logs, what a load cell under the phantom reads of them, and the device of a log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.episodes.records import catheter_name
from pipeline.settings.kinds import shown

Array = NDArray[np.float64]

QUANTITIES = ("load_cell_n", "magnitude_sum_n", "largest_contact_n")
WIRE = "wire"  # the device of a log that names no catheter
ALONE = " alone"  # behind the name of a catheter in which no wire lay


@dataclass(frozen=True)
class WallForces:
    """Forces between device and vessel in an episode, a value a step."""

    load_cell_n: Array  # magnitude of the readings of a load cell of the default calibration, N. Shape (T,).
    magnitude_sum_n: Array  # mean of the sum of the contacts' magnitudes, N. Shape (T,).
    largest_contact_n: Array  # largest single contact, N. Shape (T,).

    def moments(self) -> dict[str, list[float]]:
        """Mean and mean square of each quantity, N and N^2."""
        values = {name: getattr(self, name) for name in QUANTITIES}
        return {name: [float(value.mean()), float((value**2).mean())] for name, value in values.items()}


def wall_forces(arrays: Mapping[str, NDArray[Any]], *, interval: float, seed: int) -> WallForces | None:
    """The forces of a log's steps, `interval` s apart, but that after reset; None where it holds no numbers."""
    from cathsim.metrics.load_cell import LoadCell

    names = [*(f"extra/load_{axis}_n" for axis in "xyz"), "extra/magnitude_sum_n", "extra/largest_contact_n"]
    steps = np.asarray(arrays["step"]) > 0
    if not steps.any() or any(name not in arrays or not np.isfinite(arrays[name][steps]).all() for name in names):
        return None
    loads = np.column_stack([arrays[name][steps] for name in names[:3]])
    readings = LoadCell().read(loads, interval=interval, generator=np.random.default_rng(seed))
    return WallForces(
        load_cell_n=np.linalg.norm(readings, axis=1),
        magnitude_sum_n=arrays[names[3]][steps],
        largest_contact_n=arrays[names[4]][steps],
    )


def device_of(configuration: Mapping[str, Any]) -> str:
    """The catheter that a log names, with "alone" where no wire lay in it, or the wire alone."""
    if not configuration.get("catheter"):
        return WIRE
    name = catheter_name(configuration)
    return f"{name}{ALONE}" if configuration.get("wire", "") is None else name


@dataclass(frozen=True)
class EpisodeForces:
    """Contact forces of one logged episode."""

    phantom: str  # phantom, target and operator: as the log names them
    target: str
    operator: str
    free_force_n: float | None  # force that the operator does not pay for, N; None where the log says nothing of it
    magnitudes: Array  # (T,) N, largest resultant of each step
    points: Array  # (k, 3) m, contact positions of all steps, world frame
    forces: Array  # (k,) N, their magnitudes
    device: str = WIRE  # "wire", or the catheter over it
    # what a load cell reads, and what else the resultant hides; None for a log from before these were kept
    wall: WallForces | None = None


def read_forces(folder: Path) -> list[EpisodeForces]:
    """Reads the contact forces of every log below a folder, in the order of their paths."""
    return [episode_forces(path) for path in sorted(folder.rglob("*.mcap"))]


def episode_forces(path: Path) -> EpisodeForces:
    """Reads the contact forces of one log. The state after reset, which is no step, is left out."""
    from pipeline.episodes import EpisodeReader, EpisodeReadError

    with EpisodeReader(path) as log:
        arrays, info = log.load_arrays(pictures=False), log.info
    steps = arrays["step"] > 0
    points = arrays["contact_positions"][steps].reshape(-1, 3)
    norms = np.linalg.norm(arrays["contact_forces"][steps].reshape(-1, 3), axis=1)
    contact_mask = np.isfinite(norms)  # the arrays are padded with NaN
    expert = info.configuration.get("expert", {})
    free = expert.get("free_force") if isinstance(expert, dict) else None
    if free is not None and not isinstance(free, int | float):
        raise EpisodeReadError(f"{path} says an expert's free force of {shown(free)}, not a number: record it again")
    return EpisodeForces(
        phantom=info.phantom,
        target=info.target,
        operator=info.operator,
        free_force_n=None if free is None else float(free),
        magnitudes=np.linalg.norm(arrays["resultant_force"][steps], axis=1),
        points=points[contact_mask],
        forces=norms[contact_mask],
        device=device_of(info.configuration),
        wall=wall_forces(arrays, interval=info.control_dt, seed=info.seed),
    )


def pooled(episodes: Sequence[EpisodeForces]) -> Array:
    """Joins the forces of every step of several episodes, (n,) N."""
    return np.concatenate([episode.magnitudes for episode in episodes]) if episodes else np.zeros(0)


def pooled_wall(episodes: Sequence[EpisodeForces]) -> WallForces | None:
    """Joins the forces between device and vessel of every step; None where no log holds them."""
    walls = [episode.wall for episode in episodes if episode.wall is not None]
    if not walls:
        return None
    return WallForces(**{name: np.concatenate([getattr(one, name) for one in walls]) for name in QUANTITIES})
