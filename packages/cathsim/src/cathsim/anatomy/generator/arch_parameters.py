"""Parameters of an aortic arch: physical units, validated, and their plausible random draws."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cathsim.validation import Angle, Seed, settings

ANEURYSM_KINDS = ("fusiform", "saccular")


@settings
class Aneurysm:
    """A widening of the aorta."""

    kind: str = "fusiform"  # "fusiform" (all around) or "saccular" (a pouch to one side)
    distance: float = 0.045  # m of aortic centreline from the LSA's origin; positive towards the descending end
    length: float = 0.065  # m, from where the widening begins to where it ends
    bulge: float = 0.009  # m, how much the radius (fusiform) or one side (saccular) widens at most
    angle: Angle = 0.6  # rad about the aortic centreline, direction of a saccular pouch; 0 is the outer curvature

    def __post_init__(self) -> None:
        if self.kind not in ANEURYSM_KINDS:
            raise ValueError(f"aneurysm kind must be one of {', '.join(ANEURYSM_KINDS)}, got {self.kind!r}.")
        _check_range("aneurysm", "distance", self.distance, -0.12, 0.12)
        _check_range("aneurysm", "length", self.length, 0.02, 0.12)
        _check_range("aneurysm", "bulge", self.bulge, 0.001, 0.025)
        if self.bulge > 0.3 * self.length:
            raise ValueError(
                f"aneurysm bulge {self.bulge:g} m is too steep for its length {self.length:g} m; "
                f"take at most {0.3 * self.length:g} m."
            )


# Ranges are those within which the generator was checked; they lie a little outside the published spread.
_RANGES: dict[str, tuple[float, float]] = {
    "root_diameter": (0.024, 0.042),
    "descending_diameter": (0.017, 0.032),
    "arch_width": (0.055, 0.090),
    "ascending_height": (0.055, 0.110),
    "descending_height": (0.090, 0.270),
    "arch_skew": (-0.6, 0.6),
    "ascending_lean": (-0.1, 0.5),
    "arch_yaw": (0.2, 1.2),
    "arch_tilt": (-0.3, 0.3),
    "out_of_plane": (-0.012, 0.012),
    "tortuosity": (0.0, 0.008),
    "branch_tortuosity": (0.0, 0.007),
    "apex_ratio": (0.0, 6.0),
    "bca_diameter": (0.010, 0.019),
    "lcca_diameter": (0.0065, 0.0135),
    "lsa_diameter": (0.0085, 0.015),
    "bca_takeoff": (0.0, 1.3),
    "lcca_takeoff": (0.0, 1.55),
    "lsa_takeoff": (0.0, 1.0),
    "bca_lcca_gap": (0.0005, 0.015),
    "lcca_lsa_gap": (0.002, 0.022),
    "trunk_length": (0.035, 0.045),
    "carotid_length": (0.060, 0.110),
    "subclavian_length": (0.045, 0.110),
    "fillet_radius": (0.0015, 0.004),
}


@settings
class ArchParameters:
    """What a surgeon would measure on an aortic arch, in metres and radians."""

    root_diameter: float = 0.0318  # aorta at the root, m
    descending_diameter: float = 0.0239  # aorta 200 mm further, at the descending end, m
    arch_width: float = 0.068  # distance between the ascending and descending limbs, centreline to centreline, m
    ascending_height: float = 0.085  # height of the centreline's apex over the root, m
    descending_height: float = 0.125  # height of the centreline's apex over the descending end, m
    arch_skew: float = 0.0  # moves the bend towards the descending (positive) or ascending limb; dimensionless
    ascending_lean: float = 0.25  # lean of the ascending limb: its root lies nearer the midline, rad
    arch_yaw: float = 0.75  # turn of the arch's plane from the coronal plane, ascending limb to the front, rad
    arch_tilt: float = 0.05  # lean of the arch's plane from the vertical, rad
    out_of_plane: float = 0.005  # how far the arch bows out of its plane, m
    tortuosity: float = 0.0025  # amplitude of the aorta's windings, m
    branch_tortuosity: float = 0.0015  # amplitude of the branches' windings, m
    apex_ratio: float = 0.5  # height of the arch's top over the BCA's origin, in LCCA diameters (its clinical type)
    bca_diameter: float = 0.0145  # diameter of the brachiocephalic trunk at its origin, m
    lcca_diameter: float = 0.0095  # diameter of the left common carotid at its origin, m
    lsa_diameter: float = 0.0115  # diameter of the left subclavian at its origin, m
    # angle of the trunk to the superior axis as it leaves the arch, leaning right, rad
    bca_takeoff: float = math.radians(40)
    lcca_takeoff: float = math.radians(16)  # the same for the left common carotid, leaning left, rad
    lsa_takeoff: float = math.radians(25)  # the same for the left subclavian, leaning left and back, rad
    bca_lcca_gap: float = 0.007  # wall between the two origins along the outer curvature, m
    lcca_lsa_gap: float = 0.011  # the same between left common carotid and left subclavian, m
    trunk_length: float = 0.040  # brachiocephalic trunk from ostium to bifurcation, m
    carotid_length: float = 0.088  # left common carotid from its ostium, m; the right one ends at a similar height
    subclavian_length: float = 0.065  # left subclavian from its ostium, m
    fillet_radius: float = 0.0025  # rounding of the ostia on the lumen side, m
    bovine: bool = False  # True where BCA and LCCA have a common origin
    aneurysm: Aneurysm | None = None  # widening of the aorta, or None
    winding_seed: Seed = 0  # which of the possible windings (phases) is taken

    def __post_init__(self) -> None:
        for name, (low, high) in _RANGES.items():
            _check_range("arch", name, getattr(self, name), low, high)
        if self.descending_diameter > self.root_diameter:
            raise ValueError(
                f"the aorta narrows from its root: descending_diameter {self.descending_diameter:g} m must not exceed "
                f"root_diameter {self.root_diameter:g} m."
            )


def _check_range(owner: str, name: str, value: Any, low: float, high: float) -> None:
    if not (isinstance(value, int | float) and math.isfinite(value) and low <= value <= high):
        raise ValueError(f"{owner} parameter {name} must lie in [{low:g}, {high:g}] (m or rad), got {value!r}.")


def draw_parameters(rng: np.random.Generator) -> ArchParameters:
    """Draws one arch from the published spread; it may still be refused for its geometry."""

    def normal(mean: float, deviation: float, low: float, high: float) -> float:
        return float(np.clip(rng.normal(mean, deviation), low, high))

    root = normal(0.0318, 0.0030, 0.026, 0.039)
    apex_ratio = float(rng.uniform(0.2, 3.2))
    aneurysm = None
    if rng.random() < 0.15:
        length = float(rng.uniform(0.045, 0.080))
        aneurysm = Aneurysm(
            kind=ANEURYSM_KINDS[int(rng.integers(2))],
            distance=float(rng.uniform(0.035, 0.060)),
            length=length,
            bulge=float(rng.uniform(0.004, min(0.011, 0.2 * length))),
            angle=float(rng.uniform(-1.5, 1.5)),
        )
    return ArchParameters(
        root_diameter=root,
        descending_diameter=min(normal(0.0239, 0.0025, 0.0185, 0.030), root),
        arch_width=float(rng.uniform(0.060, 0.078)),
        ascending_height=float(rng.uniform(0.072, 0.098)),
        descending_height=float(rng.uniform(0.110, 0.140)),
        arch_skew=float(rng.uniform(-0.12, 0.08) + 0.02 * apex_ratio),
        ascending_lean=float(rng.uniform(0.05, 0.40)),
        arch_yaw=float(rng.uniform(0.55, 0.95)),
        arch_tilt=float(rng.uniform(-0.12, 0.15)),
        out_of_plane=float(rng.uniform(-0.003, 0.009)),
        tortuosity=float(rng.uniform(0.0, 0.005)),
        branch_tortuosity=float(rng.uniform(0.0005, 0.003)),
        apex_ratio=apex_ratio,
        bca_diameter=float(rng.uniform(0.0125, 0.018)),
        lcca_diameter=float(rng.uniform(0.0083, 0.0126)),
        lsa_diameter=float(rng.uniform(0.0104, 0.014)),
        bca_takeoff=math.radians(normal(45, 16, 15, 70)),
        lcca_takeoff=math.radians(normal(26, 16, 2, 50)),
        lsa_takeoff=math.radians(normal(29, 15, 5, 52)),
        bca_lcca_gap=float(rng.uniform(0.004, 0.012)),
        lcca_lsa_gap=float(rng.uniform(0.006, 0.019)),
        trunk_length=float(rng.uniform(0.035, 0.045)),
        carotid_length=float(rng.uniform(0.082, 0.095)),
        subclavian_length=float(rng.uniform(0.055, 0.075)),
        fillet_radius=float(rng.uniform(0.002, 0.003)),
        bovine=bool(rng.random() < 0.15),
        aneurysm=aneurysm,
        winding_seed=int(rng.integers(2**31)),
    )
