"""Clinical type of an aortic arch, measured on its vessel tree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cathsim.anatomy.vessel_tree import VesselTree

TYPES = ("I", "II", "III")
_BEYOND_ORIGIN = 0.025  # m above its ostium, past the flare, where the LCCA's own diameter is read


@dataclass(frozen=True)
class ArchMeasures:
    """What decides an arch's type.

    Attributes:
        drop: m from the top of the aortic arch down to the BCA's origin.
        lcca_origin_diameter: m, left common carotid at its ostium.
        lcca_diameter: m, left common carotid beyond the flare of its origin.
    """

    drop: float
    lcca_origin_diameter: float
    lcca_diameter: float

    @property
    def ratio(self) -> float:
        """Drop in diameters of the LCCA at its origin."""
        return self.drop / self.lcca_origin_diameter

    @property
    def type(self) -> str:
        """Arch type: "I" below one LCCA diameter, "II" up to two, "III" above."""
        return arch_type(self.ratio)


def arch_type(ratio: float) -> str:
    """Clinical type from the height of the arch over the BCA's origin.

    Args:
        ratio: that height in LCCA diameters.

    Returns:
        "I", "II" or "III".
    """
    return TYPES[int(np.searchsorted([1.0, 2.0], ratio, side="right"))]


def measure_arch(tree: VesselTree) -> ArchMeasures:
    """Measures an arch as a radiologist does: the top of the aortic wall against the middle of the BCA's ostium.

    Args:
        tree: an aortic arch with branches aorta, bca and lcca.

    Returns:
        The measures.
    """
    aorta, lcca = tree["aorta"], tree["lcca"]
    steepness = np.clip(aorta.tangents[:, 2], -1, 1)
    top = float(np.max(aorta.points[:, 2] + aorta.radius * np.sqrt(1 - steepness**2)))
    ostium = tree.ostium_arc("lcca")
    return ArchMeasures(
        drop=top - float(tree.ostium("bca")[2]),
        lcca_origin_diameter=2 * float(lcca.radius_at(ostium)),
        lcca_diameter=2 * float(lcca.radius_at(ostium + _BEYOND_ORIGIN)),
    )
