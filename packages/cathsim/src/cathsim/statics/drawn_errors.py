"""Errors of a real case, drawn at random: what an estimator is told differs from the truth by them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy import Phantom
from cathsim.anatomy.centreline import resampled
from cathsim.devices.pair import DevicePair
from cathsim.guidewire import Guidewire
from cathsim.statics.observed_curve import STEP
from cathsim.statics.simulated_device import changed_device, with_lumen
from cathsim.statics.uncertainty import Uncertainty, smooth_noise


@dataclass(frozen=True, eq=False)
class DrawnErrors:
    """What is told of a case."""

    phantom: Phantom  # its lumen shifted and widened
    device: Guidewire | DevicePair  # of another stiffness
    insertion: float  # error of the feeder's position, m
    rotation: float  # error of the feeder's angle, rad


def drawn_errors(
    phantom: Phantom, device: Guidewire | DevicePair, uncertainty: Uncertainty, generator: np.random.Generator
) -> DrawnErrors:
    """Draws the errors of a case, normal and independent, with the deviations of an `Uncertainty`."""
    x, y, z = (float(value) for value in uncertainty.registration * generator.standard_normal(3))
    lumen = uncertainty.lumen * float(generator.standard_normal())
    stiffness = float(np.exp(uncertainty.stiffness * generator.standard_normal()))
    wrong = changed_device(device, stiffness)
    insertion = uncertainty.insertion * float(generator.standard_normal())
    rotation = uncertainty.rotation * float(generator.standard_normal())
    moved = with_lumen(phantom, phantom.grid.offset(lumen).moved((x, y, z)))
    return DrawnErrors(moved, wrong, insertion, rotation)


def noisy_curve(
    curve: NDArray[np.float64], deviation: float, generator: np.random.Generator, *, width: float = 0.010
) -> NDArray[np.float64]:
    """A curve (n, 3) m with noise of a deviation (m) along each axis that is smooth over a width (m)."""
    points = resampled(curve, STEP)
    return np.asarray(points + deviation * smooth_noise(len(points), STEP, width, generator))
