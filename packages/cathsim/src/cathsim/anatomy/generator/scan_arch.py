"""Random aortic arches: draws from the published spread, and arches as scans show them: cut, narrow, not round."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.generator.arch_parameters import ArchParameters, draw_parameters
from cathsim.anatomy.vessel_tree import Branch, VesselTree, nearest_on_branch
from cathsim.validation import Seed, settings

if TYPE_CHECKING:
    from cathsim.anatomy.wall.relief import WallRelief


MINIMUM_SEPARATION = 2e-3  # m of wall between the lumens of vessels that do not meet
_OSTIUM_REGION = 0.008  # m beyond an ostium within which neighbours may lie nearer
_RANDOM_ATTEMPTS = 200
BOVINE_SHARE = 0.25  # of wide draws
WIDE = {
    "bca_takeoff": (0.1, 1.25),
    "lcca_takeoff": (0.0, 1.0),
    "lsa_takeoff": (0.05, 1.0),
    "apex_ratio": (0.15, 3.8),
    "tortuosity": (0.0, 0.007),
    "branch_tortuosity": (0.0, 0.0038),
    "ascending_lean": (-0.05, 0.45),
    "arch_yaw": (0.3, 1.1),
    "arch_tilt": (-0.25, 0.25),
}


LEAST_WALL = 1.2e-3  # m between the lumens of vessels that do not meet
CHILDREN = 0.3  # share of arches smaller than an adult's
ADULT, CHILD = (0.85, 1.15), (0.36, 0.85)  # sizes, as factors on the generated arch
LARGE = (0.85, 1.25)  # of elongated aortas, which are those of elderly adults
LONG_SHARE = 0.2  # of scans that show the aorta down to the diaphragm
SHORT, LONG = (0.095, 0.150), (0.150, 0.265)  # m of height of the arch over the descending end
_BRANCHES_GROW = 0.7  # exponent of the size in the branches' diameters: a child's are less small than its aorta
_LEAST_ROOT, _LEAST_DESCENDING = 0.020, 0.060  # m of aorta, at size 1, that a cut leaves beyond first and last branch
_NARROWEST = 2.2e-3  # m of radius
_LEAST_BRANCH = 0.047  # m of a branch that ends there beyond its ostium, at size 1
_ATTEMPTS = 2_000  # of elongated aortas one draw of forty is an arch
RANGES: dict[str, tuple[float, float]] = {
    **WIDE,
    "apex_ratio": (0.0, 3.8),
    "bca_takeoff": (0.0, 1.25),
    "lcca_takeoff": (0.0, 1.35),
    "arch_skew": (-0.3, 0.3),
    "lsa_takeoff": (0.0, 1.0),
    "arch_width": (0.055, 0.090),
    "bca_lcca_gap": (0.0005, 0.014),
    "lcca_lsa_gap": (0.002, 0.022),
    "branch_tortuosity": (0.0, 0.007),
    "carotid_length": (0.060, 0.100),
    "subclavian_length": (0.045, 0.105),
}
COMMON, STEEP, TRUNK = "common", "steep", "trunk"
SHAPES = (COMMON, STEEP, TRUNK)
# an elongated aorta: its branches leave the ascending limb, far below the top of the arch, and run upwards
_ELONGATED: dict[str, tuple[float, float]] = {
    "apex_ratio": (3.0, 6.0),
    "arch_skew": (0.0, 0.6),
    "ascending_height": (0.085, 0.110),
    "bca_takeoff": (0.0, 0.7),
    "lsa_takeoff": (0.0, 0.6),
}
# a common trunk from which the left common carotid turns off at up to a right angle
_TRUNK: dict[str, tuple[float, float]] = {
    "apex_ratio": (0.0, 2.2),
    "bca_takeoff": (0.0, 0.7),
    "lcca_takeoff": (0.9, 1.55),
    "bca_diameter": (0.0145, 0.0190),
}
Array = NDArray[np.float64]


def sample_parameters(rng: np.random.Generator, *, wide: bool = False) -> ArchParameters:
    """Draws a plausible aortic arch: within the published spread, buildable, no vessel running into another.

    Args:
        wide: for training: take-offs, type and windings are drawn evenly from all that can be built, and a quarter of
            the arches has a common origin of BCA and LCCA.
    """
    from cathsim.anatomy.generator.aortic_arch import build_arch

    parameters = ArchParameters()

    def draw() -> VesselTree:
        nonlocal parameters
        parameters = draw_parameters(rng)
        if wide:
            drawn: dict[str, Any] = {name: float(rng.uniform(low, high)) for name, (low, high) in WIDE.items()}
            if rng.random() < BOVINE_SHARE:
                drawn |= {"bovine": True, "bca_diameter": float(rng.uniform(0.0145, 0.0185))}
            parameters = replace(parameters, **drawn)
        return build_arch(parameters)

    drawn_tree(draw, MINIMUM_SEPARATION, _RANDOM_ATTEMPTS)
    return parameters


def drawn_tree(draw: Callable[[], VesselTree], least_wall: float, attempts: int) -> VesselTree:
    """The first drawn tree that is sound: `draw` raises no ValueError, and no vessel runs into another.

    Args:
        least_wall: m, between lumens of vessels that do not meet.
    """
    for _ in range(attempts):
        try:
            tree = draw()
            if separation(tree) >= least_wall:
                return tree
        except ValueError:  # it cannot be built, or a branch does not leave its parent
            continue
    raise RuntimeError(f"no valid tree in {attempts} draws; the ranges do not fit together.")


def separation(tree: VesselTree) -> float:
    """Thinnest wall (m) between lumens of branches away from where they join; negative where lumens overlap."""
    thinnest = np.inf
    for branch in tree:
        if branch.parent is None or branch.name == "sac":
            continue
        free = branch.arc > tree.ostium_arc(branch.name) + _OSTIUM_REGION + branch.radius[0]
        points, radius = branch.points[free], branch.radius[free]
        for other in tree:
            if other.name == branch.name or not len(points):
                continue
            away = np.ones(len(points), dtype=bool)
            if other.parent == branch.parent and not tree[branch.parent].open_end:
                away = branch.arc[free] > 0.025  # siblings of a bifurcation part slowly
            if branch.name == other.parent:
                away = branch.arc[free] < other.parent_arc - 0.025
            if not away.any():
                continue
            _, arc, distance = nearest_on_branch(other, points[away])
            thinnest = min(thinnest, float(np.min(distance - radius[away] - other.radius_at(arc))))
    return thinnest


@settings
class ScanArch:
    """The arch of a seed, as a scan might show it."""

    seed: Seed = 0
    shape: str = COMMON  # or a rare one: "steep", branches far below the arch's top, "trunk", LCCA across its trunk

    def __post_init__(self) -> None:
        if self.shape not in SHAPES:
            raise ValueError(f"shape of a scan's arch must be one of {', '.join(SHAPES)}, got {self.shape!r}.")


def build_scan_arch(arch: ScanArch) -> VesselTree:
    """Builds the vessel tree, centred on the origin; its branches are those of `build_arch`."""
    from cathsim.anatomy.generator.aortic_arch import build_arch

    rng = np.random.default_rng([arch.seed, 19, *([SHAPES.index(arch.shape)] if arch.shape != COMMON else [])])

    def draw() -> VesselTree:  # a cut may take a branch's origin
        return _seen(build_arch(_drawn_measures(rng, arch.shape)), rng, arch.shape)

    return drawn_tree(draw, LEAST_WALL, _ATTEMPTS).centred()


def drawn_relief(arch: ScanArch) -> tuple[WallRelief, np.random.Generator]:
    """The relief of the arch's wall, and the generator of its draw."""
    from cathsim.anatomy.wall.relief import WallRelief

    rng = np.random.default_rng([arch.seed, 20])
    relief = WallRelief(
        coarse=float(1e-4 + 1.2e-3 * rng.random() ** 2),
        coarse_length=float(rng.uniform(0.016, 0.026)),
        fine=float(rng.uniform(3e-5, 4e-4)),
        fine_length=float(rng.uniform(5e-3, 9e-3)),
    )
    return relief, rng


def _drawn_measures(rng: np.random.Generator, shape: str) -> ArchParameters:
    ranges = RANGES | {STEEP: _ELONGATED, TRUNK: _TRUNK}.get(shape, {})
    drawn: dict[str, Any] = {name: float(rng.uniform(low, high)) for name, (low, high) in ranges.items()}
    if shape == TRUNK:
        drawn["bovine"] = True
    elif rng.random() < BOVINE_SHARE:
        drawn |= {"bovine": True, "bca_diameter": float(rng.uniform(0.0145, 0.0185))}
    drawn["descending_height"] = float(rng.uniform(*(LONG if rng.random() < LONG_SHARE else SHORT)))
    return replace(draw_parameters(rng), **drawn)


def _seen(tree: VesselTree, rng: np.random.Generator, shape: str) -> VesselTree:
    """The tree at another size, its aorta narrower in places and cut at both ends."""
    child = rng.random() < CHILDREN and shape != STEEP
    size = float(rng.uniform(*(CHILD if child else LARGE if shape == STEEP else ADULT)))
    aorta = tree.root
    leaving = [branch.parent_arc for branch in tree if branch.parent == aorta.name and branch.name != "sac"]
    narrow = float(rng.uniform(0.0, 0.55 if child else 0.3))
    place = min(leaving) - float(rng.uniform(-0.010, 0.020))
    width = float(rng.uniform(0.012, 0.035))
    waves = _waves(aorta.arc, float(rng.uniform(0.0, 0.05)), rng)
    radius = aorta.radius * (1 - narrow * np.exp(-(((aorta.arc - place) / width) ** 2))) * (1 + waves)
    first = rng.random() ** 2 * max(min(leaving) - _LEAST_DESCENDING, 0.0)
    last = aorta.length - float(rng.uniform(0.0, max(aorta.length - max(leaving) - _LEAST_ROOT, 0.0)))
    within = (aorta.arc >= first) & (aorta.arc <= last)
    cut = float(aorta.arc[within][0])
    branches = [Branch(aorta.name, size * aorta.points[within], size * radius[within])]
    for branch in tree.branches[1:]:
        along = size * (branch.parent_arc - (cut if branch.parent == aorta.name else 0.0))
        thick = size if branch.name == "sac" else size**_BRANCHES_GROW
        end = branch.length
        if branch.open_end and branch.name in ("lcca", "lsa"):
            end = max((1 - 0.6 * rng.random()) * end, tree.ostium_arc(branch.name) + _LEAST_BRANCH)
        within = branch.arc <= end
        points, radii = size * branch.points[within], np.maximum(thick * branch.radius[within], _NARROWEST)
        branches.append(Branch(branch.name, points, radii, branch.parent, along, branch.open_end))
    return VesselTree(tuple(branches))


def _waves(arc: Array, height: float, rng: np.random.Generator) -> Array:
    """Relative changes of a radius along a vessel, over 40 and 70 mm."""
    phases = rng.uniform(0, 2 * np.pi, 2)
    return height * (np.sin(2 * np.pi * arc / 0.040 + phases[0]) + np.sin(2 * np.pi * arc / 0.070 + phases[1])) / 2
