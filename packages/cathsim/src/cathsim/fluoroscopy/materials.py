"""Materials of wires and catheters under X-rays: attenuation coefficients, and sections of nested cylinders."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Annotated

import numpy as np
from annotated_types import Interval, Len
from numpy.typing import ArrayLike, NDArray

from cathsim.fluoroscopy.curve import ROUND_END
from cathsim.validation import Length, Unit, settings

Array = NDArray[np.float64]

# Linear attenuation coefficients at 60 keV, 1/m, from NIST's tables for elements (as the package xrayatten 0.1.1
# bundles them), mixed by mass. The tungsten-filled jacket is polyurethane with 40 % of its mass of tungsten: an
# assumption.
ATTENUATION: dict[str, float] = {
    "nitinol": 763.0,
    "tungsten_polyurethane": 307.0,
    "polyurethane": 23.0,
    "tungsten": 7166.0,
    "gold": 8739.0,
    "steel": 948.0,
    "water": 20.6,
    "blood": 21.4,
    "silicone": 27.1,
    "acrylic": 22.9,
    "bone": 60.4,
    "iodine_mg_per_ml": 0.76,
}

LEAST_MARKER = 1e-4  # m of a marker behind the round end that is drawn

_Radius = Annotated[float, Interval(gt=0, le=0.1), Unit("m")]
_Attenuation = Annotated[float, Interval(ge=0, le=1e6), Unit("1/m")]


@settings
class Section:
    """A stretch of a device: nested cylinders, each filling what the inner ones leave."""

    length: Length  # m; the last section of a wire goes on to its end
    # (radius in m, attenuation in 1/m), innermost first
    layers: Annotated[tuple[tuple[_Radius, _Attenuation], ...], Len(1)]

    def __post_init__(self) -> None:
        radii = [radius for radius, _ in self.layers]
        if any(a >= b for a, b in itertools.pairwise(radii)):
            raise ValueError(f"a section's layers must have growing positive radii (m), innermost first, got {radii}.")

    @property
    def radius(self) -> float:
        """Of the outermost layer, m."""
        return self.layers[-1][0]

    def depth(self, distance: ArrayLike) -> Array:
        """Optical depth of rays across the section at distances (m) from the axis, of any shape."""
        x2 = np.square(np.asarray(distance, dtype=np.float64))
        total, inner = np.zeros_like(x2), np.zeros_like(x2)
        for radius, attenuation in self.layers:
            chord = 2 * np.sqrt(np.maximum(radius * radius - x2, 0.0))
            total += attenuation * (chord - inner)
            inner = chord
        return total


@settings
class WireMaterial:
    """A wire, or a catheter, from its tip on."""

    sections: tuple[Section, ...]  # from the tip; the last one's length does not matter

    def __post_init__(self) -> None:
        if not self.sections:
            raise ValueError("a wire's material needs at least one section.")

    @property
    def starts(self) -> Array:
        """(sections,) m from the tip, where each begins."""
        return np.concatenate(([0.0], np.cumsum([section.length for section in self.sections[:-1]])))

    @property
    def radius(self) -> float:
        """The largest of its sections, m."""
        return max(section.radius for section in self.sections)


def jacketed_wire(radius: float) -> WireMaterial:
    """A nitinol core in a tungsten-filled polymer jacket of a radius (m) (the kind of the Radifocus).

    The core has two thirds of the diameter and thins over the distal 30 mm.
    """
    core, jacket = ATTENUATION["nitinol"], ATTENUATION["tungsten_polyurethane"]
    shares = ((0.010, 0.22), (0.010, 0.35), (0.010, 0.50), (1.0, 0.67))
    return WireMaterial(tuple(Section(length, ((share * radius, core), (radius, jacket))) for length, share in shares))


def coil_tipped_wire(radius: float) -> WireMaterial:
    """A nitinol shaft of a radius (m) with a tungsten coil over the distal 30 mm (the kind of the Nitrex)."""
    core, coil = ATTENUATION["nitinol"], ATTENUATION["tungsten"]
    tip = Section(0.030, ((0.3 * radius, core), (0.8 * radius, 0.0), (radius, 0.7 * coil)))  # wound with gaps
    return WireMaterial((tip, Section(1.0, ((radius, core),))))


def steel_wire(radius: float) -> WireMaterial:
    """A steel core in a steel coil of an outer radius (m) (the kind of the Amplatz); the core thins over 30 mm.

    The core has 0.6 of the diameter, the coil fills 85 % of the ring from 0.7 of it on: 79 % of the section is steel,
    as the presets' density says.
    """
    steel = ATTENUATION["steel"]
    sections = [
        Section(length, ((share * radius, steel), (0.7 * radius, 0.0), (radius, 0.85 * steel)))
        for length, share in ((0.010, 0.2), (0.020, 0.4), (1.0, 0.6))
    ]
    return WireMaterial(tuple(sections))


def catheter_material(
    radius: float, inner_radius: float, *, wall: float, marker: float, marker_length: float, lumen: str = "water"
) -> WireMaterial:
    """A tube of outer and inner radius (m) in water or blood, with a marker (m) in its wall at the tip.

    Attenuations are over that of the water that the tube displaces, which is a tenth of the wall's own, so that a wire
    in the lumen adds its own.

    Args:
        wall: attenuation of the wall, 1/m.
        marker: of the wall where the marker is, 1/m.
        lumen: what fills it where no wire is, a name of `ATTENUATION`: "water" (saline), "blood".
    """
    over = {name: max(value - ATTENUATION["water"], 0.0) for name, value in (("wall", wall), ("marker", marker))}
    content = max(ATTENUATION[lumen] - ATTENUATION["water"], 0.0)
    shaft = Section(1.0, ((inner_radius, content), (radius, over["wall"])))
    if not marker_length:
        return WireMaterial((shaft,))
    return WireMaterial((Section(marker_length, ((inner_radius, content), (radius, over["marker"]))), shaft))


def flat_marker(catheter: WireMaterial) -> WireMaterial:
    """A catheter's material for nodes that start `ROUND_END` radii behind its tip, whose end is drawn round.

    So drawn, the marker covers the area of one with flat ends.
    """
    if len(catheter.sections) == 1:
        return catheter
    marker, *shaft = catheter.sections
    length = max(marker.length - ROUND_END * catheter.radius, LEAST_MARKER)
    return WireMaterial((replace(marker, length=length), *shaft))


_MATERIALS = {"nitrex_straight": coil_tipped_wire, **dict.fromkeys(("floppy", "amplatz", "stiff"), steel_wire)}


def wire_material(name: str, radius: float) -> WireMaterial:
    """Material of a guidewire preset of an outer radius (m): the jacketed wire unless the preset has its own."""
    return _MATERIALS.get(name, jacketed_wire)(radius)
