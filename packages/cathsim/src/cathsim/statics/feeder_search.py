"""The feeder's rotation from a curve: that with which the simulated device rests nearest to it."""

from __future__ import annotations

import math

import numpy as np

from cathsim.simulation import Simulation
from cathsim.statics.feeder import Feeder
from cathsim.statics.laying import distance_to, lay_along
from cathsim.statics.observed_curve import ObservedCurve

ANGLES = 12  # tried around the circle
NEAR = 0.15  # rad from the last frame's rotation that are tried
_REST_STEPS = 3  # control steps before a trial is judged
_HALVINGS = 3  # of the angle between trials, around the best


def found_rotation(simulation: Simulation, curve: ObservedCurve, insertion: float, last: float | None) -> float:
    """Searches the rotation (rad) with which the device lies nearest to the curve after a short rest.

    Args:
        simulation: of the nominal device; it is moved.
        insertion: of the feeder, m.
        last: rotation of the last frame, near which it is searched; None: around the circle.
    """
    tried: dict[float, float] = {}

    def distance(rotation: float) -> float:
        if rotation not in tried:
            lay_along(simulation, curve, Feeder(insertion, rotation))
            for _ in range(_REST_STEPS):
                simulation.advance(0.0, 0.0)
            tried[rotation] = distance_to(simulation, curve) if simulation.valid else math.inf
        return tried[rotation]

    if last is not None:
        return min((last + step * NEAR for step in (0, -1, 1)), key=distance)
    step = 2 * math.pi / ANGLES
    best = min((float(angle) for angle in np.arange(ANGLES) * step - math.pi), key=distance)
    for _ in range(_HALVINGS):
        step /= 2
        best = min((best, best - step, best + step), key=distance)
    return best
