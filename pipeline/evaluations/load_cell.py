"""What a load cell under the phantom reads, from episode logs: the readings, and the device of a log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

QUANTITIES = ("load_cell_n", "magnitude_sum_n", "largest_contact_n")
WIRE = "wire"  # the device of a log that names no catheter
ALONE = " alone"  # behind the name of a catheter in which no wire lay


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
    """The catheter that a log names, with "alone" where no wire lay in it, or the wire alone."""
    if not configuration.get("catheter"):
        return WIRE
    name = str(configuration.get("catheter_preset") or "own catheter")
    return f"{name}{ALONE}" if configuration.get("wire", "") is None else name
