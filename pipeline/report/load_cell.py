"""What a load cell under the phantom reads, from episode logs: the readings, and the table by operator and device."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pipeline.report.results import SAMPLES, Table

if TYPE_CHECKING:
    from pipeline.report.learning.logs import Evaluation

Array = NDArray[np.float64]

QUANTITIES = ("load_cell_n", "magnitude_sum_n", "largest_contact_n")
WIRE = "wire"  # the device of a log that names no catheter


@dataclass(frozen=True)
class WallForces:
    """Forces between device and vessel in an episode, a value a step.

    Attributes:
        load_cell_n: magnitude of the readings of a load cell of the default calibration, N. Shape (T,).
        magnitude_sum_n: mean of the sum of the contacts' magnitudes, N. Shape (T,).
        largest_contact_n: largest single contact, N. Shape (T,).
    """

    load_cell_n: Array
    magnitude_sum_n: Array
    largest_contact_n: Array

    def moments(self) -> dict[str, list[float]]:
        """Mean and mean square of each quantity, N and N^2."""
        values = {name: getattr(self, name) for name in QUANTITIES}
        return {name: [float(value.mean()), float((value**2).mean())] for name, value in values.items()}


def wall_forces(arrays: Mapping[str, NDArray[Any]], *, interval: float, seed: int) -> WallForces | None:
    """Reads the forces of a log's steps, the state after reset left out.

    Args:
        arrays: of `EpisodeReader.load_arrays`.
        interval: from one step to the next, s.
        seed: of the cell's noise.

    Returns:
        None for a log from before these quantities were kept, or with values that are not finite.
    """
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
    """The catheter that a log names, or the wire alone."""
    catheter = configuration.get("catheter")
    if isinstance(catheter, Mapping):
        return str(catheter.get("name", "catheter"))
    return WIRE if not catheter else str(catheter)


def load_cell_table(rows: Mapping[tuple[str, str, str, str], Sequence[Evaluation]]) -> Table:
    """Mean and standard deviation over all steps of every operator, by phantom, target and device.

    Args:
        rows: evaluations by stage, phantom, target and row.
    """
    table: Table = {}
    for (stage, phantom, target, name), evaluations in rows.items():
        for device in sorted({one.device for one in evaluations}):
            chosen = [one for one in evaluations if one.device == device and one.wall_forces is not None]
            if not chosen:
                continue
            weights = np.array([one.metrics.steps for one in chosen], float)
            cells: dict[str, Any] = {SAMPLES: len(chosen)}
            for quantity in QUANTITIES:
                moments = np.array([(one.wall_forces or {})[quantity] for one in chosen])
                mean, square = np.average(moments, axis=0, weights=weights)
                cells[quantity] = [float(mean), float(np.sqrt(max(square - mean**2, 0.0)))]
            table[f"{phantom}/{target}/{device}/{stage}/{name}"] = cells
    return table
