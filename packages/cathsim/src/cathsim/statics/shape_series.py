"""Forces from a series of shapes: the contact force at each moment of an episode, with known or drawn errors."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy import Phantom
from cathsim.devices.pair import DevicePair
from cathsim.guidewire import Guidewire
from cathsim.statics.estimator import ContactForceEstimator
from cathsim.statics.observed_curve import inserted_part, noisy_curve
from cathsim.statics.uncertainty import Uncertainty, changed_device, with_lumen

_LOGGER = logging.getLogger(__name__)


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


def forces_of_shapes(
    shapes: NDArray[np.float64],
    feeders: NDArray[np.float64],
    devices: Mapping[str, Any],
    phantom: Phantom,
    generator: np.random.Generator | None = None,
) -> tuple[NDArray[np.float64], int]:
    """Estimates the resultant contact force at successive moments.

    Args:
        shapes: points of the device's axis in the world, m. Shape (T, n, 3).
        feeders: insertion (m) and rotation (rad, without jumps) of wire and catheter. Shape (T, feeders, 2).
        devices: arguments of `cathsim.devices.pair.DevicePair`: "wire", "catheter", "torsion".
        generator: draws noise of the curves, and errors of stiffness, feeders and lumen; None: there are none.

    Returns:
        Forces (T,), N, and how many curves after the first were refused, whose force is 0.
    """
    outer = devices.get("catheter") or devices["wire"]
    device, sizes = devices["wire"] if outer is devices["wire"] else DevicePair(**devices), Uncertainty()
    known = DrawnErrors(phantom, device, 0.0, 0.0)
    if generator is not None:
        known = drawn_errors(phantom, device, sizes, generator)
    estimator = ContactForceEstimator(known.phantom, known.device, friction=outer.friction)
    forces, refused = np.zeros(len(shapes)), 0
    for moment, points in enumerate(shapes):
        curve = inserted_part(points, float(feeders[moment, :, 0].max()))
        if generator is not None:
            curve = noisy_curve(curve, sizes.curve, generator)
        wrong = feeders[moment] + (known.insertion, known.rotation)
        wrong[:, 0] = np.clip(wrong[:, 0], 0.0, estimator.max_insertion)
        (insertion, rotation), *others = wrong.tolist()
        try:
            estimate = estimator.update(curve, insertion, rotation, catheter=tuple(others[0]) if others else None)
        except ValueError as error:
            _LOGGER.debug("moment %d: %s", moment, error)
            refused += moment > 0
        else:
            forces[moment] = estimate.resultant.value
    return forces, refused
