"""Breathing: the vessel moves rigidly to and fro, as a function of time; the sheath stays where it is."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from cathsim.validation import Listed, Unit, settings

MOTION = 6  # numbers of user data: displacement, velocity (vessel.h)
_Component = Annotated[float, Interval(ge=-1, le=1)]
_Direction = Annotated[tuple[_Component, _Component, _Component], Listed]


@settings
class Breathing:
    """Displacement a (1 - cos(2 pi t / T)) / 2 of a vessel along a direction: 0 when exhaled, a when inhaled.

    Attributes:
        amplitude: a, the farthest displacement, m.
        direction: of the displacement when inhaled, world frame; by default towards the feet. Shape (3,), its
            components in -1 to 1.
        period: T, s; 4 s are 0.25 Hz.
    """

    amplitude: Annotated[float, Interval(ge=0, le=0.02), Unit("m")] = 0.005
    direction: _Direction = (0.0, 0.0, -1.0)
    period: Annotated[float, Interval(ge=0.5, le=3600), Unit("s")] = 4.0

    def __post_init__(self) -> None:
        if not np.linalg.norm(self.direction) > 0:
            raise ValueError(f"direction must not be zero, got {self.direction}")

    @property
    def farthest(self) -> NDArray[np.float64]:
        """The displacement when inhaled, m, world frame. Shape (3,)."""
        direction = np.array(self.direction)
        return np.asarray(self.amplitude * direction / np.linalg.norm(direction))

    @property
    def rate(self) -> float:
        """Angular frequency, rad/s."""
        return 2 * math.pi / self.period

    def displacement(self, time: float) -> NDArray[np.float64]:
        """The displacement at a time (s), m, world frame. Shape (3,)."""
        return self.farthest * (0.5 * (1.0 - math.cos(self.rate * time)))

    def velocity(self, time: float) -> NDArray[np.float64]:
        """The velocity at a time (s), m/s, world frame. Shape (3,)."""
        return self.farthest * (0.5 * self.rate * math.sin(self.rate * time))
