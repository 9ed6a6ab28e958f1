"""Contact forces read from episode logs, and the rows of the table that compares them with real ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pipeline.evaluations.load_cell import QUANTITIES, WIRE, WallForces, device_of, wall_forces
from pipeline.settings.checks import shown

if TYPE_CHECKING:
    from cathsim.metrics.forces import ForceComparison

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EpisodeForces:
    """Contact forces of one logged episode.

    Attributes:
        phantom, target, operator: as the log names them.
        free_force_n: force that the operator does not pay for, N; None where the log says nothing of it.
        magnitudes: (T,) N, largest resultant of each step.
        points: (k, 3) m, contact positions of all steps, world frame.
        forces: (k,) N, their magnitudes.
        device: "wire", or the catheter over it.
        wall: what a load cell reads, and what else the resultant hides; None for a log from before these were kept.
    """

    phantom: str
    target: str
    operator: str
    free_force_n: float | None
    magnitudes: Array
    points: Array
    forces: Array
    device: str = WIRE
    wall: WallForces | None = None


def read_forces(folder: Path) -> list[EpisodeForces]:
    """Reads the contact forces of every log below a folder, in the order of their paths."""
    return [episode_forces(path) for path in sorted(folder.rglob("*.mcap"))]


def episode_forces(path: Path) -> EpisodeForces:
    """Reads the contact forces of one log. The state after reset, which is no step, is left out.

    Raises:
        EpisodeReadError: the log is damaged, or names a free force that is no number.
    """
    from pipeline.episodes import EpisodeReader, EpisodeReadError

    with EpisodeReader(path) as log:
        arrays, info = log.load_arrays(pictures=False), log.info
    steps = arrays["step"] > 0
    points = arrays["contact_positions"][steps].reshape(-1, 3)
    norms = np.linalg.norm(arrays["contact_forces"][steps].reshape(-1, 3), axis=1)
    there = np.isfinite(norms)  # the arrays are padded with NaN
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
        points=points[there],
        forces=norms[there],
        device=device_of(info.configuration),
        wall=wall_forces(arrays, interval=info.control_dt, seed=info.seed),
    )


def pooled(episodes: Sequence[EpisodeForces]) -> Array:
    """Joins the forces of every step of several episodes, (n,) N."""
    return np.concatenate([episode.magnitudes for episode in episodes]) if episodes else np.zeros(0)


def pooled_wall(episodes: Sequence[EpisodeForces]) -> WallForces | None:
    """Joins the forces between device and vessel of every step; None where no log holds them."""
    there = [episode.wall for episode in episodes if episode.wall is not None]
    if not there:
        return None
    return WallForces(**{name: np.concatenate([getattr(one, name) for one in there]) for name in QUANTITIES})


def table_rows(
    c: ForceComparison, pushed: Array, agrees: str, differs: str, wall: WallForces | None = None
) -> dict[str, dict[str, Any]]:
    """Fills the report's table `force_validation`.

    Args:
        pushed: (n,) N, forces of the same wire pushed without a planner.
        wall: what a load cell reads of the same episodes.

    Returns:
        Row to column to cell.
    """
    cells: dict[str, Any] = {
        "u_statistic": round(c.u_statistic, 1),
        "p_value": c.mann_whitney_p,
        "shapiro_p": c.shapiro_p,
        "levene_p": c.levene_p,
        "simulated_force_n": [c.mean_n, c.sd_n],
        "real_force_n": [c.real_mean_n, c.real_sd_n],
        "samples": c.n,
        "exceedance_pct": 100 * c.exceedance,
        "simulated_median_n": c.median_n,
        "simulated_p95_n": c.p95_n,
        "simulated_max_n": c.max_n,
        "contact_pct": 100 * c.contact_share,
        "pushed_force_n": [float(pushed.mean()), float(pushed.std())],
        "agrees": agrees,
        "differs": differs,
    }
    if wall is not None:
        cells |= {name: [float(getattr(wall, name).mean()), float(getattr(wall, name).std())] for name in QUANTITIES}
    rows = {row: {"value": cell} for row, cell in cells.items()}
    rows["simulated_force_n"]["n"] = c.n
    rows["pushed_force_n"]["n"] = len(pushed)
    return rows
