"""The unit of length of a surface file, which the file does not tell: known from how wide an aorta is."""

from __future__ import annotations

import math
from dataclasses import dataclass

from cathsim.anatomy.mesh.budget import Budget
from cathsim.anatomy.mesh.cavity import find_cavity
from cathsim.anatomy.mesh.reading import Triangles
from cathsim.anatomy.mesh.refusal import MeshRefusedError
from cathsim.anatomy.mesh.samples import sample_surface

UNITS: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}
_WIDTH, _EXTENT = 0.028, 0.22  # m: an aorta's widest place, and an arch's largest extent
_EXTENT_WEIGHT = 0.25  # extents differ more: some models reach down to the groin
_WORST = 1.1  # score beyond which no unit makes an aorta of the surface
_CLOSE = 0.35  # scores nearer to each other than this leave a choice
_VOXELS = 130  # along the largest extent


def check_unit(unit: str | None) -> None:
    """Refuses an unknown unit.

    Args:
        unit: one of UNITS, or None where it is to be detected.

    Raises:
        MeshRefusedError: for anything else.
    """
    if unit is not None and unit not in UNITS:
        raise MeshRefusedError(f"unknown unit {unit!r}; choose from {', '.join(UNITS)}, or leave it out.")


@dataclass(frozen=True)
class Size:
    """How large a lumen is.

    Attributes:
        width: of its widest ball, in the file's unit.
        extent: longest side of the whole, in the file's unit.
    """

    width: float
    extent: float

    def score(self, unit: str) -> float:
        """How far it is from an aorta in a unit; 0: it has an aorta's width and extent."""
        metres = UNITS[unit]
        width, extent = self.width * metres / _WIDTH, self.extent * metres / _EXTENT
        return math.log(width) ** 2 + _EXTENT_WEIGHT * math.log(extent) ** 2

    def in_order(self) -> list[str]:
        """The units, the one that fits best first."""
        return sorted(UNITS, key=self.score)

    def told(self, unit: str) -> str:
        """Width and extent in a unit, in words."""
        width, extent = (1e3 * UNITS[unit] * length for length in (self.width, self.extent))
        return f"its widest vessel is then {width:.3g} mm wide and the whole {extent:.3g} mm long"

    def hint(self, unit: str) -> str:
        """What speaks against a given unit; empty where it fits about as well as any."""
        best = self.in_order()[0]
        if best == unit or self.score(best) > _WORST or self.score(unit) - self.score(best) < _CLOSE:
            return ""
        return f"in {unit} {self.told(unit)}; {best} would fit ({self.width * UNITS[best] * 1e3:.3g} mm wide)"


def measure_size(mesh: Triangles, budget: Budget) -> Size:
    """Measures the widest ball in a lumen, and the whole, at a rough resolution.

    Args:
        mesh: with its borders closed, in the file's unit.
        budget: of the import.

    Returns:
        Its size in the file's unit.

    Raises:
        MeshRefusedError: where there is no lumen.
    """
    spacing = mesh.extent / _VOXELS
    samples = sample_surface(mesh.corners, 0.7 * spacing, budget)
    return Size(2 * find_cavity(samples, spacing, in_metres=False).widest, mesh.extent)


def detect_unit(size: Size) -> tuple[str, str, tuple[str, ...]]:
    """Tells the unit from the width of the widest ball in the lumen, and from the extent of the whole.

    Args:
        size: of the lumen.

    Returns:
        One of UNITS, the reason in words, and a note where it is unsure.

    Raises:
        MeshRefusedError: where in no unit it could be an aorta's.
    """
    best, second = size.in_order()[:2]
    width = f"its widest vessel is then {size.width * UNITS[best] * 1e3:.3g} mm wide"
    if size.score(best) > _WORST:
        raise MeshRefusedError(
            f"in no unit is this an aorta ({best} comes nearest, {width}, and the whole "
            f"{size.extent * UNITS[best] * 1e3:.3g} mm long); if it is one, give its unit."
        )
    if size.score(second) - size.score(best) >= _CLOSE:
        return best, f"detected: {width}, as an aorta is", ()
    other = f"{second} could be meant ({size.width * UNITS[second] * 1e3:.3g} mm wide): give the unit to be sure"
    return (
        best,
        f"detected: {width}, as an aorta is; but {other}",
        (f"the unit is unsure: {best} is taken, but {other}",),
    )
