"""The unit of length of a surface file, which the file does not tell: known from how wide an aorta is."""

from __future__ import annotations

import math

from .mesh_cavity import find_cavity
from .mesh_reading import Triangles
from .mesh_refusal import MeshRefusedError
from .mesh_samples import sample_surface

UNITS: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}
_WIDTH, _EXTENT = 0.028, 0.22  # m: an aorta's widest place, and an arch's largest extent
_EXTENT_WEIGHT = 0.25  # extents differ more: some models reach down to the groin
_WORST = 1.1  # score beyond which no unit makes an aorta of the surface
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


def detect_unit(mesh: Triangles) -> tuple[str, str]:
    """Tells the unit from the width of the widest ball in the lumen, and from the extent of the whole.

    Args:
        mesh: with its borders closed, in the file's unit.

    Returns:
        One of UNITS, and the reason in words.

    Raises:
        MeshRefusedError: where there is no lumen, or in no unit could it be an aorta's.
    """
    spacing = mesh.extent / _VOXELS
    width = 2 * find_cavity(sample_surface(mesh.corners, 0.7 * spacing), spacing, in_metres=False).widest
    scores = {
        unit: math.log(width * metres / _WIDTH) ** 2 + _EXTENT_WEIGHT * math.log(mesh.extent * metres / _EXTENT) ** 2
        for unit, metres in UNITS.items()
    }
    best, second = sorted(scores, key=lambda unit: scores[unit])[:2]
    measures = f"its widest vessel is then {width * UNITS[best] * 1e3:.0f} mm wide"
    if scores[best] > _WORST:
        raise MeshRefusedError(
            f"in no unit is this an aorta ({best} comes nearest, {measures}, and the whole "
            f"{mesh.extent * UNITS[best] * 1e3:.0f} mm long); if it is one, give its unit."
        )
    reason = f"detected: {measures}, as an aorta is"
    if scores[second] - scores[best] < 0.35:
        other = width * UNITS[second] * 1e3
        reason += f"; but {second} could be meant ({other:.0f} mm wide): give the unit to be sure"
    return best, reason
