"""The guidewire: its mechanics in physical units, and the chain of capsules that stands for it in MuJoCo."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, TypeVar, cast, overload

import mujoco
import numpy as np
from annotated_types import Interval, Len
from numpy.typing import NDArray

from cathsim.devices.device_file import GUIDEWIRE, in_file, is_file, preset_path, read_device
from cathsim.validation import Angle, LengthOrNone, Listed, Turn, Unit, quantity, settings

LINK_NAME, TIP_SITE = "wire{}", "tip"
NMM2 = 1.0e-6  # one N mm^2 in N m^2
LEAST_FRICTION = 0.002  # a smaller coefficient is taken as none, which takes a third of the contacts' equations
THICKEST, LONGEST = 0.01, 5.0  # m: what goes beyond was meant in another unit
POISSON_RATIO = 0.33  # of nitinol and of steel, within 0.03

Array = NDArray[np.float64]
Distance = TypeVar("Distance", float, Array)  # one distance from the tip, or an array of them
Stiffness = Annotated[float, Interval(gt=0, le=1e6), Unit("N mm^2")]
_LinkLength = Annotated[float, Interval(gt=0, le=0.5), Unit("m")]


def tapered(from_tip: Distance, taper: tuple[float, float], tip: float, shaft: float) -> Distance:
    """A stiffness at distances from the tip (m), whose logarithm is linear between the two distances of `taper` (m).

    Nearer to the tip it is `tip`, farther from it `shaft`, in any unit.
    """
    value = np.exp(np.interp(from_tip, taper, (np.log(tip), np.log(shaft))))
    return cast(Distance, value if np.ndim(from_tip) else float(value))


@settings
class Guidewire:
    """A wire that bends and does not twist or stretch, as a chain of links with two hinges between neighbours.

    A hinge between links of lengths a and b has the stiffness EI / ((a + b) / 2), which makes the chain bend like a
    rod of bending stiffness EI. Torsion is rigid: what turns the proximal end turns the tip.

    Attributes:
        links: lengths from the proximal to the distal end, m.
        diameter: m.
        shaft_stiffness_nmm2: bending stiffness EI proximally of `taper[1]`, N mm^2.
        tip_stiffness_nmm2: EI distally of `taper[0]`, N mm^2; between them its logarithm is linear in arc length.
        taper: the two distances from the tip, m.
        tip_angle: angle by which the unloaded tip is bent, rad.
        tip_length: length of the bent part, m.
        density: kg/m^3, mean over core and jacket.
        relaxation: time in which a bent free wire relaxes, s; joint damping is relaxation x stiffness.
        friction: sliding friction coefficient on the wall; none below LEAST_FRICTION.
        motor_joints: distal joints with motors in the 21-action control mode.
        motor_angle: angle by which a motor bends its free joint at full action, rad.
        torsional_stiffness_nmm2: torsional stiffness GJ of the shaft, N mm^2, for simulations with elastic torsion; it
            falls towards the tip as EI does. None: EI / (1 + Poisson's ratio), as of a solid round core.
        working_length: from the hub, where the wire is turned, to the tip, m, for elastic torsion.
    """

    links: Annotated[tuple[_LinkLength, ...], Listed, Len(2, 2000)] = (0.016,) * 10 + (0.008,) * 8 + (0.004,) * 10
    diameter: Annotated[float, Interval(gt=0, le=THICKEST), Unit("m")] = 0.89e-3
    shaft_stiffness_nmm2: Stiffness = 400.0
    tip_stiffness_nmm2: Stiffness = 15.0
    taper: Annotated[tuple[LengthOrNone, LengthOrNone], Listed] = (0.025, 0.060)
    tip_angle: Angle = np.radians(80.0)
    tip_length: Annotated[float, Interval(ge=0, le=LONGEST), Unit("m")] = 0.020
    density: Annotated[float, Interval(gt=0, le=30000), Unit("kg/m^3")] = 6450.0
    relaxation: Annotated[float, Interval(ge=0, le=100), Unit("s")] = 0.1
    friction: Annotated[float, Interval(ge=0, le=10)] = 0.06
    motor_joints: Annotated[int, Interval(ge=0, le=2000)] = 10
    motor_angle: Turn = np.radians(12.0)
    torsional_stiffness_nmm2: Stiffness | None = None
    working_length: Annotated[float, Interval(gt=0, le=LONGEST), Unit("m")] = 1.5

    def __post_init__(self) -> None:
        if self.length > LONGEST:
            raise ValueError(f"a guidewire of {self.length:g} m is longer than {LONGEST:g} m; lengths are in metres")
        if not self.taper[0] <= self.taper[1]:
            raise ValueError(f"taper must be two increasing distances from the tip (m), got {self.taper}")
        if min(self.links) < self.diameter:
            raise ValueError(
                f"links ({min(self.links)} m) shorter than the diameter ({self.diameter} m) are no capsules"
            )

    @property
    def length(self) -> float:
        """Length from end to end, m."""
        return float(sum(self.links))

    @property
    def radius(self) -> float:
        """Half the diameter, m."""
        return self.diameter / 2

    @property
    def joints(self) -> int:
        """Number of two-hinge joints."""
        return len(self.links) - 1

    def stiffness(self, from_tip: Distance) -> Distance:
        """Bending stiffness EI (N m^2) at distances from the tip (m), one or an array."""
        return tapered(from_tip, self.taper, self.tip_stiffness_nmm2, self.shaft_stiffness_nmm2) * NMM2

    def torsional_stiffness(self, from_tip: Distance) -> Distance:
        """Torsional stiffness GJ (N m^2) at distances from the tip (m), one or an array."""
        shaft = self.torsional_stiffness_nmm2
        ratio = 1 / (1 + POISSON_RATIO) if shaft is None else shaft / self.shaft_stiffness_nmm2
        return ratio * self.stiffness(from_tip)

    @overload
    def rest_curvature(self, from_tip: float) -> complex: ...

    @overload
    def rest_curvature(self, from_tip: Array) -> NDArray[np.complex128]: ...

    def rest_curvature(self, from_tip: float | Array) -> complex | NDArray[np.complex128]:
        """Curvature of the unloaded wire (1/m) at distances from the tip (m), one or an array.

        A real number, as the tip is bent in one plane: the complex plane is the wire's cross-section. 0 beyond the
        bent part and beyond the tip.
        """
        distance = np.asarray(from_tip, dtype=np.float64)
        bent = (distance >= 0) & (distance <= self.tip_length)
        curvature = np.where(bent, self.tip_angle / self.tip_length if self.tip_length else 0.0, 0.0).astype(complex)
        return curvature if distance.ndim else complex(curvature)

    def scaled(self, length: float) -> Guidewire:
        """The same wire, at least `length` (m) long, with whole links added or dropped at the proximal end."""
        length = quantity("the length of a guidewire", length, Annotated[float, Interval(gt=0, le=LONGEST), Unit("m")])
        links, shaft = list(self.links), self.links[0]
        while sum(links) < length - 1e-9:
            links.insert(0, shaft)
        while len(links) > 2 and sum(links) - links[0] >= length - 1e-9:
            links.pop(0)
        return dataclasses.replace(self, links=tuple(links))

    def distal(self, count: int) -> Guidewire:
        """The most distal `count` links of the wire."""
        return dataclasses.replace(self, links=self.links[len(self.links) - count :])

    def add_to(self, parent: mujoco.MjsBody, *, mass_scale: float = 1.0, clamped: bool = False) -> list[mujoco.MjsGeom]:
        """Adds the chain to a body, from its origin along its +z.

        Args:
            parent: body that holds the first link rigidly, of a specification in radians (`compiler.degree = False`).
            mass_scale: factor on the density: larger is faster to simulate and, the motion being quasi-static,
                changes forces little.
            clamped: the wire is a rod clamped at the parent's origin: a joint there stands for the bending of the first
                half link. Without it the first link is rigid, as inside the feeder.

        Returns:
            The capsules, proximal first.
        """
        body, geoms = parent, []
        for index, length in enumerate(self.links):
            if index > 0 or clamped:
                start = self.links[index - 1] if index > 0 else 0.0
                body = body.add_body(name=LINK_NAME.format(index), pos=[0, 0, start])
                self._add_joint(body, index)
            geoms.append(
                body.add_geom(
                    name=LINK_NAME.format(index),
                    type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                    size=[self.radius, length / 2, 0],
                    pos=[0, 0, length / 2],
                    density=self.density * mass_scale,
                    contype=0,
                    conaffinity=1,
                    condim=3 if self.friction >= LEAST_FRICTION else 1,
                    priority=1,
                    friction=[self.friction, 0.0, 0.0],
                    solref=[0.004, 1.0],
                    solimp=[0.98, 0.998, 0.0002, 0.5, 2.0],
                    rgba=[0.12, 0.12, 0.14, 1.0],
                )
            )
        body.add_site(name=TIP_SITE, pos=[0, 0, self.links[-1]], size=[self.radius] * 3, rgba=[0.9, 0.1, 0.1, 1])
        return geoms

    def _add_joint(self, body: mujoco.MjsBody, index: int) -> None:
        # a joint stands for the bending of the half links on both its sides; at a clamp there is one
        before = self.links[index - 1] if index > 0 else 0.0
        length = (before + self.links[index]) / 2
        from_tip = sum(self.links[index:])
        stiffness = self.stiffness(from_tip) / length
        bent = from_tip <= self.tip_length + 1e-9 and self.tip_length > 0
        rest = self.tip_angle * length / self.tip_length if bent else 0.0
        for axis, name, angle in (([1, 0, 0], "x", rest), ([0, 1, 0], "y", 0.0)):
            body.add_joint(
                name=f"{LINK_NAME.format(index)}{name}",
                type=mujoco.mjtJoint.mjJNT_HINGE,
                axis=axis,
                stiffness=[stiffness, 0, 0],
                damping=[self.relaxation * stiffness, 0, 0],
                springref=angle,
                armature=1e-9,
            )


_NAMES = (
    *("default", "thesis", "radifocus_angled", "radifocus_angled_025", "nitrex_straight"),
    *("floppy", "amplatz", "stiff", "arch_variety"),
)


def _of_file(path: str | Path) -> Guidewire:
    try:
        return Guidewire(**read_device(path, GUIDEWIRE).fields)
    except ValueError as error:
        raise ValueError(in_file(path, error)) from None


# files in cathsim/devices/presets/guidewires
GUIDEWIRES: dict[str, Guidewire] = {name: _of_file(preset_path(GUIDEWIRE, name)) for name in _NAMES}


def load_guidewire(name: str | Path, **changes: object) -> Guidewire:
    """A preset wire, or one's own from a YAML file, with fields of `Guidewire` replaced.

    Args:
        name: of a preset, or a path that ends in .yaml or .yml.

    Raises:
        ValueError: unknown preset or field; a file that is missing or does not describe a guidewire.
    """
    if is_file(name):
        wire = _of_file(name)
    elif name in GUIDEWIRES:
        wire = GUIDEWIRES[str(name)]
    else:
        raise ValueError(f"unknown guidewire '{name}'; there are {', '.join(GUIDEWIRES)}, or a path of a .yaml file")
    return dataclasses.replace(wire, **changes)  # type: ignore[arg-type]


def preset_of(wire: Guidewire) -> tuple[str, float] | None:
    """The preset that a wire is, and the length in m that it was scaled to, 0 where it was not; None: of no preset."""
    for name, preset in GUIDEWIRES.items():
        if preset == wire:
            return name, 0.0
    for name, preset in GUIDEWIRES.items():
        if preset.scaled(wire.length) == wire:
            return name, wire.length
    return None
