"""Where the feeders of one or two devices are: as given, and moved by the deviations of a case."""

from __future__ import annotations

import math
from dataclasses import dataclass

from cathsim.statics.uncertainty import Deviation


@dataclass(frozen=True)
class Feeder:
    """Positions of the feeders."""

    insertion: float  # of the wire, or of the only device, m
    rotation: float  # of its hub, rad
    catheter: tuple[float, float] | None = None  # insertion (m) and rotation (rad) of a catheter over the wire

    @property
    def furthest(self) -> float:
        """Insertion of the device that is further in, m."""
        return max(self.insertion, self.catheter[0]) if self.catheter else self.insertion

    def deviating(self, case: Deviation, limit: float) -> Feeder:
        """With the errors of a case, those of a catheter being the wire's; insertions lie in 0 to `limit` (m)."""
        first = (_within(self.insertion + case.insertion, limit), self.rotation + case.rotation)
        if self.catheter is None:
            return Feeder(*first)
        second = (_within(self.catheter[0] + case.insertion, limit), self.catheter[1] + case.rotation)
        return Feeder(*first, second)

    def moves_from(self, last: Feeder) -> tuple[tuple[float, float], tuple[float, float]]:
        """Translation (m) and rotation (rad) since a last position: of the wire, and of the catheter."""
        wire = (self.insertion - last.insertion, self.rotation - last.rotation)
        if self.catheter is None or last.catheter is None:
            return wire, (0.0, 0.0)
        return wire, (self.catheter[0] - last.catheter[0], self.catheter[1] - last.catheter[1])


def checked_catheter(catheter: tuple[float, float], limit: float) -> tuple[float, float]:
    """Checks a catheter's insertion (m) and rotation (rad).

    Raises:
        ValueError: not two finite numbers, or an insertion out of 0 to `limit` (m).
    """
    try:
        insertion, rotation = (float(value) for value in catheter)
    except (TypeError, ValueError):
        raise ValueError(f"catheter must be an insertion (m) and a rotation (rad), got {catheter!r}") from None
    if not (math.isfinite(insertion) and math.isfinite(rotation) and 0 <= insertion <= limit):
        raise ValueError(
            f"the catheter's insertion must lie in 0 to {limit:.3f} m and its rotation be finite, got {catheter!r}"
        )
    return insertion, rotation


def checked_number(name: str, value: float, unit: str) -> float:
    """Refuses with a `ValueError` what is no number."""
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be a number ({unit}), got {value!r}") from None


def _within(insertion: float, limit: float) -> float:
    return min(max(insertion, 0.0), limit)
