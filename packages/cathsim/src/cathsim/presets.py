"""Presets of a simulation: how finely physics is stepped, how often an operator decides, how far feeders then move."""

from __future__ import annotations

import dataclasses
import math
from typing import Annotated

import numpy as np
from annotated_types import Interval

from cathsim.validation import Unit, settings

WIRE_RADIUS = 0.45e-3  # m, of the usual guidewire of 0.035 in
MAXIMUM_SIZE = 4096  # px, of an image's side
CONTROL_STEP = 0.1  # s
TRANSLATION_STEP = 0.002  # m at full action
ROTATION_STEP = np.radians(15.0)  # rad at full action

_Depth = Annotated[float, Interval(ge=0, le=0.1), Unit("m")]
_Tolerances = Annotated[float, Interval(gt=0, le=1e6)]


@settings
class Accuracy:
    """Time stepping of a simulation.

    Attributes:
        timestep: of a substep, s.
        refinement: a substep that ends with the wire deep in the wall is repeated in so many shorter ones; 1: never.
        tolerance: penetration that calls for it, m.
        rise: ... if the penetration also grew by this much in the substep, m.
        mass_scale: factor on the wire's mass.
        deep: a repetition that ends so many tolerances deep in the wall is itself repeated.
        catheter_refinement, catheter_deep: `refinement` (None: the same) and `deep` of a wire in a catheter.
    """

    timestep: Annotated[float, Interval(ge=1e-6, le=0.1), Unit("s")]
    refinement: Annotated[int, Interval(ge=1, le=10_000)]
    tolerance: _Depth = 3e-4
    rise: _Depth = 1e-4
    mass_scale: Annotated[float, Interval(gt=0, le=1e6)] = 1.0
    deep: _Tolerances = 3.0
    catheter_refinement: Annotated[int, Interval(ge=1, le=10_000)] | None = None
    catheter_deep: _Tolerances = 2.0  # a reverse curve that snaps comes faster than a wire

    @property
    def with_catheter(self) -> Accuracy:
        """The numerics of a wire in a catheter: its `refinement` and `deep` are those of a catheter."""
        refinement = self.catheter_refinement or self.refinement
        return dataclasses.replace(self, refinement=refinement, catheter_refinement=None, deep=self.catheter_deep)


# The motion is quasi-static, so more than the wire's mass changes forces little and keeps contacts stiff at long steps.
# With a catheter fewer repetitions come nearly as near to `reference` (docs/results/simulator.md).
ACCURACY: dict[str, Accuracy] = {
    "reference": Accuracy(timestep=0.001, refinement=4),
    "accurate": Accuracy(
        timestep=0.010,
        refinement=8,
        tolerance=2e-4,
        rise=5e-5,
        mass_scale=10.0,
        catheter_refinement=3,
        catheter_deep=1.5,
    ),
    "fast": Accuracy(timestep=0.020, refinement=4, tolerance=5e-4, rise=3e-4, mass_scale=30.0, catheter_refinement=2),
}


def dividing(numerics: Accuracy, interval: float) -> Accuracy:
    """The numerics with the timestep that divides an interval (s) and is nearest to theirs."""
    substeps = max(round(interval / numerics.timestep), 1)
    if abs(substeps * numerics.timestep - interval) <= 1e-9:
        return numerics
    return dataclasses.replace(numerics, timestep=interval / substeps)


@settings
class Pace:
    """The control step of a simulation and what full actions move in it.

    Attributes:
        interval: between two decisions, s.
        translation: of a feeder at full action, m a decision.
        rotation: of a feeder at full action, rad a decision.
    """

    interval: Annotated[float, Interval(ge=0.01, le=1.0), Unit("s")] = CONTROL_STEP
    translation: Annotated[float, Interval(gt=0, le=0.02), Unit("m")] = TRANSLATION_STEP
    rotation: Annotated[float, Interval(gt=0, le=math.pi), Unit("rad")] = ROTATION_STEP


# 7.5 decisions a second, 35 mm/s and 180 degrees/s; source: as of `arch_variety.task`
PACES = {"usual": Pace(), "arch_variety": Pace(1 / 7.5, 0.035 / 7.5, math.pi / 7.5)}
