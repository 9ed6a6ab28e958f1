"""A wire and a catheter that are used together, either of which may be absent."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from cathsim.devices.catheter import Catheter
from cathsim.guidewire import LONGEST, Guidewire
from cathsim.validation import LengthOrNone, Unit, settings

REACH = 0.33  # m of each device are simulated at least
SHEATH_GAP = 0.27e-3  # between the outer device and the sheath's bore, m
SHEATH_FLARE = 3e-3  # by how much the bore of a catheter's sheath is wider at its mouth, m
_FINE, _MEDIUM, _COARSE = 0.004, 0.012, 0.016  # links, m
_FINE_LENGTH, _MEDIUM_LENGTH = 0.024, 0.084  # of the chain's end where links are fine, and then medium, m
_THIN = 0.5e-3  # m: devices of a smaller radius go where vessels bend within 4 mm ...
_FINE_OF_THIN, _MEDIUM_OF_THIN = (0.005, 0.12), (0.01, 0.10)  # m, ... with such links over such lengths
_SHAPE_MARGIN = 0.040  # links are medium this far beyond a catheter's shape, so that the wire can be ahead, m

Torsion = Literal["elastic", "rigid"]


Array = NDArray[np.float64]


@settings
class DevicePair:
    """A wire within a catheter: one rod, whose end is the tip of the device that is further in.

    Attributes:
        wire: None: the catheter alone.
        catheter: None: the wire alone.
        torsion: "elastic": hub and tip of a device are turned differently; "rigid": what turns the hub turns the tip.
        most_ahead: how far the wire's tip may be ahead of the catheter's, m.
        most_behind: how far it may be withdrawn into the catheter, m.
        reach: length of both devices that is simulated, m; 0: the wire's, 0.33 m at least.

    Raises:
        ValueError: neither device, a catheter that the wire does not pass, or a reach beyond a device's length.
    """

    wire: Guidewire | None
    catheter: Catheter | None
    torsion: Torsion = "elastic"
    most_ahead: Annotated[float, Interval(ge=0, le=LONGEST), Unit("m")] = 0.30
    most_behind: Annotated[float, Interval(ge=0, le=LONGEST), Unit("m")] = 0.20
    reach: LengthOrNone = 0.0

    def __post_init__(self) -> None:
        if self.wire is None and self.catheter is None:
            raise ValueError("neither a wire nor a catheter is there: give one of them at least")
        if self.wire is not None and self.catheter is not None and self.wire.diameter >= self.catheter.inner_diameter:
            raise ValueError(
                f"a wire of {1e3 * self.wire.diameter:.2f} mm does not pass a catheter with a lumen of "
                f"{1e3 * self.catheter.inner_diameter:.2f} mm: take a thinner wire or a wider catheter"
            )
        if self.simulated_length > self.shortest:
            raise ValueError(
                f"a reach of {self.simulated_length:.3f} m is longer than the shorter device, {self.shortest:.3f} m"
            )

    @property
    def both(self) -> bool:
        """Whether neither device is absent."""
        return self.wire is not None and self.catheter is not None

    @property
    def shortest(self) -> float:
        """Length of the shorter device from hub to tip, m."""
        wire = self.wire.working_length if self.wire else math.inf
        return min(wire, self.catheter.length if self.catheter else math.inf)

    @property
    def simulated_length(self) -> float:
        """Length of the chain, m."""
        return self.reach or max(REACH, self.wire.length if self.wire else 0.0)

    @property
    def radius(self) -> float:
        """Of the outermost device, m."""
        if self.catheter is not None:
            return self.catheter.radius
        assert self.wire is not None
        return self.wire.radius

    @property
    def sheath_radius(self) -> float:
        """Of the bore of the sheath that both are fed through, m."""
        return self.radius + SHEATH_GAP

    @property
    def sheath_flare(self) -> float:
        """By how much that bore is wider at its mouth, m: a bent catheter would be caught by an edge."""
        return SHEATH_FLARE if self.catheter else 0.0

    def links(self) -> tuple[float, ...]:
        """Lengths of the chain's links from the proximal end, m: finer where a shape is to be followed."""
        shape = max((bend[1] for bend in self.catheter.shape), default=0.0) if self.catheter else 0.0
        medium = max(_MEDIUM_LENGTH, shape + _SHAPE_MARGIN - _FINE_LENGTH if shape > _FINE_LENGTH else 0.0)
        near, middle = (_FINE, _FINE_LENGTH), (_MEDIUM, medium)
        if self.radius < _THIN:
            near, middle = _FINE_OF_THIN, _MEDIUM_OF_THIN
        counts = [round(near[1] / near[0]), math.ceil(middle[1] / middle[0] - 1e-9)]
        left = self.simulated_length - counts[0] * near[0] - counts[1] * middle[0]
        counts.append(max(1, math.ceil(left / _COARSE - 1e-9)))
        return (_COARSE,) * counts[2] + (middle[0],) * counts[1] + (near[0],) * counts[0]

    def chain(self, linear_density: float, radius: float) -> Guidewire:
        """The chain as a wire of a mass a metre (kg) and a radius (m), from which models are made."""
        density = linear_density / (math.pi * radius**2)
        friction = max(device.friction for device in (self.wire, self.catheter) if device is not None)
        return Guidewire(links=self.links(), diameter=2 * radius, density=density, friction=friction, motor_joints=0)


def points_behind(points: Array, links: Sequence[float], behind: float) -> Array:
    """The part of a chain that begins at a distance behind its tip.

    Args:
        points: ends of the chain's links from its tip on, m. Shape (n + 1, 3).
        links: lengths of the n links from the proximal end, m.
        behind: where the part begins, m along the chain from its tip.

    Returns:
        The part's beginning, then the ends of the links behind it, m. Shape (k, 3).
    """
    arcs = np.concatenate(([0.0], np.cumsum(links[::-1])))
    first = int(np.searchsorted(arcs, behind, side="right"))
    share = (behind - arcs[first - 1]) / (arcs[first] - arcs[first - 1]) if first < len(arcs) else 0.0
    start = points[first - 1] + share * (points[min(first, len(points) - 1)] - points[first - 1])
    return np.concatenate((start[None], points[first:]))


def wire_and_catheter(points: Array, links: Sequence[float], lead: float) -> tuple[Array, Array]:
    """Both devices, each from its tip on, m. Shapes (k, 3) and (m, 3).

    Args:
        points, links: as of `points_behind`.
        lead: how far the wire's tip is ahead of the catheter's, m; negative: withdrawn into it.
    """
    return points_behind(points, links, max(-lead, 0.0)), points_behind(points, links, max(lead, 0.0))
