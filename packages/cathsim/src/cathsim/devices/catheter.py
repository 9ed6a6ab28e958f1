"""The catheter: dimensions, stiffness profile and unloaded shape, checked to be those of a tube that can exist."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Annotated, overload

import numpy as np
from annotated_types import Interval, Len
from numpy.typing import NDArray

from cathsim.guidewire import LONGEST, NMM2, THICKEST, Array, Distance, Stiffness, tapered
from cathsim.validation import Angle, Length, LengthOrNone, Listed, Unit, settings

RAMP = 3e-3  # m over which a bend's curvature rises at its one end and falls at the other

_SAMPLE = 0.33  # of the diameter: distance between points of the centreline that are tried for a crossing
_SAMPLES = 2000  # at most
_MARGIN = 1e-9  # m

Attenuation = Annotated[float, Interval(ge=0, le=1e6), Unit("1/m")]
Bend = tuple[LengthOrNone, Length, Angle, Angle]  # start and end from the tip (m), angle, plane (rad)


@settings
class Catheter:
    """A tube with an unloaded shape, which a guidewire passes. Lengths are measured from the distal tip.

    Attributes:
        outer_diameter: m; 1 French is 1/3 mm.
        inner_diameter: of the lumen, m.
        length: from the hub, where it is turned, to the tip, m.
        shaft_stiffness_nmm2: bending stiffness EI proximally of `taper[1]`, N mm^2.
        tip_stiffness_nmm2: EI distally of `taper[0]`, N mm^2; between them its logarithm is linear in arc length.
        taper: the two distances from the tip, m.
        shape: bends of the unloaded catheter, each (start, end, angle, plane): between two distances from the tip (m)
            the axis turns by an angle (rad) in a plane through it (rad about the axis, 0 for a planar shape). Curvature
            is constant but for ramps of `RAMP` at both ends, shorter where the bend is shorter than two of them: the
            forces change steadily as one device slides along the other. The ramps lie within the bend, whose angle is
            exactly the integral of curvature.
        torsional_stiffness_nmm2: torsional stiffness GJ of the shaft, N mm^2; it falls towards the tip as EI does.
        density: mass over the volume of the full disc of the outer diameter, kg/m^3: wall and what fills the lumen.
        friction: sliding friction coefficient on the wall.
        relaxation: time in which the bent free catheter relaxes, s.
        marker_length: of the radiopaque marker at the tip, m; 0: none.
        wall_attenuation: linear attenuation coefficient of the wall at 60 keV, 1/m.
        marker_attenuation: that of the wall where the marker is, 1/m.

    Raises:
        ValueError: of a shape that no tube has: a bend of a radius below that of the tube, bends that overlap or that
            lie beyond the catheter, an axis that passes itself nearer than half a diameter.
    """

    outer_diameter: Annotated[float, Interval(gt=0, le=THICKEST), Unit("m")] = 1.67e-3
    inner_diameter: Annotated[float, Interval(gt=0, le=THICKEST), Unit("m")] = 1.2e-3
    length: Annotated[float, Interval(gt=0, le=LONGEST), Unit("m")] = 1.0
    shaft_stiffness_nmm2: Stiffness = 300.0
    tip_stiffness_nmm2: Stiffness = 80.0
    taper: Annotated[tuple[LengthOrNone, LengthOrNone], Listed] = (0.010, 0.040)
    shape: Annotated[tuple[Annotated[Bend, Listed], ...], Listed, Len(0, 100)] = ()
    torsional_stiffness_nmm2: Stiffness = 300.0
    density: Annotated[float, Interval(gt=0, le=30000), Unit("kg/m^3")] = 1100.0
    friction: Annotated[float, Interval(ge=0, le=10)] = 0.06
    relaxation: Annotated[float, Interval(ge=0, le=100), Unit("s")] = 0.1
    marker_length: LengthOrNone = 0.0
    wall_attenuation: Attenuation = 170.0
    marker_attenuation: Attenuation = 1430.0

    def __post_init__(self) -> None:
        if not self.inner_diameter < self.outer_diameter:
            raise ValueError(
                f"the inner diameter of a catheter ({_mm(self.inner_diameter)}) must be smaller than its outer one "
                f"({_mm(self.outer_diameter)})"
            )
        if not self.taper[0] <= self.taper[1]:
            raise ValueError(f"taper must be two increasing distances from the tip (m), got {self.taper}")
        if self.marker_length > self.length:
            raise ValueError(f"a marker of {_mm(self.marker_length)} is longer than its catheter of {_mm(self.length)}")
        self._check_bends()
        self._check_crossing()

    @property
    def radius(self) -> float:
        """Half the outer diameter, m."""
        return self.outer_diameter / 2

    def stiffness(self, from_tip: Distance) -> Distance:
        """Bending stiffness EI (N m^2) at distances from the tip (m), one or an array."""
        return tapered(from_tip, self.taper, self.tip_stiffness_nmm2, self.shaft_stiffness_nmm2) * NMM2

    def torsional_stiffness(self, from_tip: Distance) -> Distance:
        """Torsional stiffness GJ (N m^2) at distances from the tip (m), one or an array."""
        return self.torsional_stiffness_nmm2 / self.shaft_stiffness_nmm2 * self.stiffness(from_tip)

    @overload
    def rest_curvature(self, from_tip: float) -> complex: ...

    @overload
    def rest_curvature(self, from_tip: Array) -> NDArray[np.complex128]: ...

    def rest_curvature(self, from_tip: float | Array) -> complex | NDArray[np.complex128]:
        """Curvature of the unloaded catheter (1/m) at distances from the tip (m), one or an array.

        A vector in the cross-section as a complex number, whose real part is the plane in which a guidewire's
        `tip_angle` bends; a bend of an angle in a plane gives exp(i plane). 0 beyond both ends.
        """
        distance = np.asarray(from_tip, dtype=np.float64)
        curvature = np.zeros(distance.shape, dtype=np.complex128)
        for start, end, angle, plane in self.shape:
            ramp = _ramp(start, end)
            inward = np.clip(np.minimum(distance - start, end - distance) / ramp, 0.0, 1.0)
            # a raised cosine, whose mean over a ramp is one half
            curvature += 0.5 * (1 - np.cos(np.pi * inward)) * (angle / (end - start - ramp)) * np.exp(1j * plane)
        return curvature if distance.ndim else complex(curvature)

    def centreline(self, from_tip: Array) -> Array:
        """The unloaded shape, (n, 3) m, at increasing distances (n,) from the tip, m; see `unloaded_centreline`."""
        return unloaded_centreline(self.rest_curvature, from_tip)

    def _check_bends(self) -> None:
        for start, end, angle, _ in self.shape:
            if not start < end:
                raise ValueError(f"a bend must start nearer to the tip than it ends, got {_mm(start)} and {_mm(end)}")
            if end > self.length + _MARGIN:
                raise ValueError(
                    f"a bend that ends at {_mm(end)} lies beyond the catheter, which has {_mm(self.length)}"
                )
            tightest = (end - start - _ramp(start, end)) / abs(angle) if angle else np.inf
            if tightest < self.radius:
                raise ValueError(
                    f"a bend of {np.degrees(angle):.0f} degrees from {_mm(start)} to {_mm(end)} has a radius of "
                    f"{_mm(tightest)}, below the catheter's of {_mm(self.radius)}: make it longer or smaller"
                )
        for before, after in itertools.pairwise(sorted(self.shape)):
            if after[0] < before[1] - _MARGIN:
                raise ValueError(
                    f"bends overlap between {_mm(after[0])} and {_mm(min(before[1], after[1]))} from the tip: give "
                    "each stretch one bend"
                )

    def _check_crossing(self) -> None:
        """Refuses an axis that passes itself nearer than half a diameter.

        Limbs that lie beside each other, as those of a pigtail's loop, give way to the side by up to a diameter, which
        a planar shape does not say: nearer than half a diameter, one would have to run through the other.
        """
        if sum(abs(angle) for _, _, angle, _ in self.shape) < np.pi:
            return  # an axis that turns by less than half a turn does not come back to itself
        bent = max(end for _, end, _, _ in self.shape)
        reach = min(2 * bent, self.length)  # what is bent reaches back at most along its own length
        step = max(_SAMPLE * self.outer_diameter, reach / _SAMPLES)
        distance = np.linspace(0.0, reach, int(np.ceil(reach / step)) + 1)
        points = self.centreline(distance)
        apart = np.linalg.norm(points[:, None] - points, axis=-1)
        along = distance[None] - distance[:, None]
        # a stretch of less than half a turn at the tightest radius does not come back either
        near = (along > np.pi * self.radius) & (apart < self.radius)
        if near.any():
            first, second = np.unravel_index(np.where(near, apart, np.inf).argmin(), near.shape)
            raise ValueError(
                f"the unloaded catheter runs through itself: {_mm(distance[first])} and {_mm(distance[second])} from "
                f"the tip its axis is {_mm(apart[first, second])} apart, less than half its diameter"
            )


def unloaded_centreline(rest_curvature: Callable[[Array], NDArray[np.complex128]], from_tip: Array) -> Array:
    """The axis of a device without loads, gravity and another device.

    Args:
        rest_curvature: curvature (1/m) at distances from the tip (m), as the devices' method gives it.
        from_tip: (n,) distances from the tip, increasing, m; curvature is integrated by the midpoint rule between them.

    Returns:
        (n, 3) m, from the tip on. The most proximal point is the origin, where the axis comes along +z; a bend in plane
        0 by a positive angle turns the tip towards -y, as a guidewire's `tip_angle` does.
    """
    proximal_first = np.asarray(from_tip, dtype=np.float64)[::-1]
    steps = proximal_first[:-1] - proximal_first[1:]
    turns = rest_curvature((proximal_first[:-1] + proximal_first[1:]) / 2) * steps
    axes = np.zeros((len(steps), 3))
    frame = np.eye(3)  # columns: both directions of the cross-section, and the axis
    for index, half in enumerate(_rotations(turns / 2)):
        frame = frame @ half
        axes[index] = frame[:, 2]
        frame = frame @ half
    points = np.concatenate((np.zeros((1, 3)), np.cumsum(steps[:, None] * axes, axis=0)))
    return points[::-1].copy()


def _ramp(start: float, end: float) -> float:
    return min(RAMP, (end - start) / 2)


def _rotations(turns: NDArray[np.complex128]) -> Array:
    """Rotations (n, 3, 3) of a frame (columns x, y, axis) by bends whose planes are the numbers' directions.

    A real number is a rotation about x, as of a guidewire's hinge; an imaginary one about y.
    """
    angle = np.abs(turns)
    direction = np.where(angle > 0, turns, 1.0) / np.where(angle > 0, angle, 1.0)
    x, y, c, s = direction.real, direction.imag, np.cos(angle), np.sin(angle)
    rows = (
        (c + x * x * (1 - c), x * y * (1 - c), y * s),
        (x * y * (1 - c), c + y * y * (1 - c), -x * s),
        (-y * s, x * s, c),
    )
    return np.moveaxis(np.array(rows), -1, 0)


def _mm(length: float) -> str:
    return f"{1e3 * length:.4g} mm"
