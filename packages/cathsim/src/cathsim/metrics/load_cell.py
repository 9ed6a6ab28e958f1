"""The force that a load cell under the phantom reads: the resultant on the vessel, filtered, with the cell's noise.

The cell sees one vector: minus all contact forces of the wall on the device, normal and frictional, along the whole
shaft, and minus the drag of the blood on it. The latter because the flow is driven: what the fluid gives to wall and
device together does not change with the device, so what the device takes the wall loses. In equilibrium this is the
force with which feeder and sheath hold the device. Opposite walls cancel in it, so it is smaller than the sum of the
contacts' magnitudes. The sheath stands for the robot's guide: it is no part of the phantom unless asked for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from cathsim.validation import Listed, Unit, settings

if TYPE_CHECKING:
    from cathsim.simulation import Simulation

Array = NDArray[np.float64]

_Resolution = Annotated[float, Interval(ge=0, le=10), Unit("N")]


@settings
class LoadCell:
    """A load cell of six axes below a phantom that lies on its back.

    Attributes:
        resolution: of the force along x, y, z of the world, N: the standard deviation of a reading's white noise, and
            the step that readings are rounded to. The cell's own z axis is vertical, which is the world's y.
        cutoff: of a low-pass filter of first order, Hz; 0: none. The mean over a control step of 0.1 s, which a reading
            starts from, is itself a filter with half the power at 4.4 Hz.
        bears_sheath: whether the sheath is mounted on the plate that the cell bears, as the phantom is.
    """

    resolution: Annotated[tuple[_Resolution, _Resolution, _Resolution], Listed] = (1 / 200, 1 / 100, 1 / 200)
    cutoff: Annotated[float, Interval(ge=0, le=1000), Unit("Hz")] = 2.0
    bears_sheath: bool = False

    def load(self, forces: StepForces) -> Array:
        """What the cell bears in a control step, N, world frame, to be given to `read`. Shape (3,)."""
        return forces.load + forces.sheath if self.bears_sheath else forces.load

    def read(self, loads: Array, *, interval: float, generator: np.random.Generator) -> Array:
        """Reads the forces of an episode.

        Args:
            loads: mean force on the vessel over each control step, N, world frame. Shape (T, 3).
            interval: of a control step, s.
            generator: of the noise.

        Returns:
            Readings, N, world frame. Shape (T, 3).

        Raises:
            ValueError: the loads have another shape, or are not finite.
        """
        loads = np.asarray(loads, dtype=np.float64)
        if loads.ndim != 2 or loads.shape[1] != 3 or not np.isfinite(loads).all():
            raise ValueError(f"expected finite loads of shape (T, 3), got shape {loads.shape}")
        gain = 1.0 - math.exp(-2 * math.pi * self.cutoff * interval) if self.cutoff > 0 else 1.0
        readings, level = np.empty_like(loads), loads[0] if len(loads) else np.zeros(3)
        for row, load in zip(readings, loads, strict=True):
            level = level + gain * (load - level)
            row[:] = level
        steps = np.array(self.resolution)
        readings += steps * generator.standard_normal(readings.shape)
        rounded = np.divide(readings, steps, out=np.zeros_like(readings), where=steps > 0).round() * steps
        return np.where(steps > 0, rounded, readings)


# Calibrations of the ATI Mini40 by the manufacturer's names; which one was under the real phantom is not published.
# Figures as the manufacturer (ATI Industrial Automation, manual 9620-05) is understood to give them: neither the manual
# nor a certificate was at hand to check them. Ranges: 20, 40 and 80 N across, 60, 120 and 240 N along the axis.
MINI40: dict[str, LoadCell] = {
    "SI-20-1": LoadCell(resolution=(1 / 200, 1 / 100, 1 / 200)),
    "SI-40-2": LoadCell(resolution=(1 / 100, 1 / 50, 1 / 100)),
    "SI-80-4": LoadCell(resolution=(1 / 50, 1 / 25, 1 / 50)),
}


@dataclass(frozen=True)
class StepForces:
    """Forces between device and vessel in one control step.

    Attributes:
        load: mean force on the vessel, N, world frame. Shape (3,).
        sheath: mean force on the sheath, N, world frame. Shape (3,).
        magnitude_sum: mean of the sum of the contacts' magnitudes, N.
        largest_contact: largest force of a single contact over the substeps, N.
    """

    load: Array
    sheath: Array
    magnitude_sum: float
    largest_contact: float


def step_forces(simulation: Simulation) -> StepForces:
    """Reads the forces of a simulation's last control step; the blood's drag is that of its last substep."""
    summary = simulation.summary
    drag = simulation.blood_forces().sum(axis=0)
    return StepForces(
        load=-np.array(summary.mean_force) - drag,
        sheath=-np.array(summary.sheath_force),
        magnitude_sum=float(summary.magnitude_sum),
        largest_contact=float(summary.contact_max),
    )
