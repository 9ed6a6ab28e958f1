"""Forces from a series of shapes: the contact force at each moment of an episode, with known or drawn errors."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy import Phantom
from cathsim.devices.pair import DevicePair
from cathsim.statics.drawn_errors import DrawnErrors, drawn_errors, noisy_curve
from cathsim.statics.estimator import ContactForceEstimator
from cathsim.statics.observed_curve import inserted_part
from cathsim.statics.uncertainty import Uncertainty

_LOGGER = logging.getLogger(__name__)


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
            found = estimator.update(curve, insertion, rotation, catheter=tuple(others[0]) if others else None)
        except ValueError as error:
            _LOGGER.debug("moment %d: %s", moment, error)
            refused += moment > 0
        else:
            forces[moment] = found.resultant.value
    return forces, refused
