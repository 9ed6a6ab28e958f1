"""Arches of the arch variety: drawn from their type and a seed, those that are no vessels drawn again."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Interval

from cathsim.anatomy.generator.random_arch import separation
from cathsim.anatomy.generator.variety.branching_types import ARCH_TYPES, BRANCHING, TRUNKS, Origin
from cathsim.anatomy.generator.variety.courses import MM, Knot, course_curve, draw_course
from cathsim.anatomy.vessel_tree import Branch, VesselTree
from cathsim.validation import Seed, settings

CALIBRE = 0.85  # factor on the generator's diameters in the published task
LEAST_WALL = 1e-3  # m of wall between the lumens of vessels that do not meet
TIGHTEST = 0.9  # curvature times radius of the aorta
_ATTEMPTS = 100


@settings
class VarietyArch:
    """An arch of the arch variety: its branching type, the seed of its draws, and the factor on its diameters."""

    arch_type: str = "I"
    seed: Seed = 0
    calibre: Annotated[float, Interval(ge=0.7, le=1.3)] = CALIBRE

    def __post_init__(self) -> None:
        if self.arch_type not in ARCH_TYPES:
            raise ValueError(f"arch_type must be one of {', '.join(ARCH_TYPES)}, got {self.arch_type!r}")


def drawn_type(seed: int) -> str:
    """The branching type of a seed, each as likely as the others."""
    return ARCH_TYPES[int(np.random.default_rng([seed, len(ARCH_TYPES)]).integers(len(ARCH_TYPES)))]


def build_variety_arch(arch: VarietyArch) -> VesselTree:
    """Builds the vessel tree of an arch, centred on the origin.

    Returns:
        Branches aorta (from the descending end over the arch to the root), rsa, rcca, lcca, lsa, and as the type has
        them bca, carotid_trunk (of both carotids) and subclavian_trunk (of both subclavians).
    """
    rng = np.random.default_rng([arch.seed, ARCH_TYPES.index(arch.arch_type)])
    for _ in range(_ATTEMPTS):
        tree = _draw(arch, rng)
        if tree is not None and separation(tree) >= LEAST_WALL:
            low = np.min([np.min(b.points - b.radius[:, None], axis=0) for b in tree], axis=0)
            high = np.max([np.max(b.points + b.radius[:, None], axis=0) for b in tree], axis=0)
            return tree.translated(-(low + high) / 2)
    raise RuntimeError(f"no arch of type {arch.arch_type} in {_ATTEMPTS} draws; its waypoints do not fit together")


def _draw(arch: VarietyArch, rng: np.random.Generator) -> VesselTree | None:
    """One draw; None where the aorta bends too tightly or a vessel does not leave its parent."""
    aorta = Branch("aorta", *course_curve(draw_course("aorta", np.zeros(3), rng, calibre=arch.calibre)))
    if _tightest(aorta) > TIGHTEST:
        return None
    branches, knots = {"aorta": aorta}, dict[str, Knot]()
    variants = BRANCHING[arch.arch_type]
    from_root = 0.0
    for origin in variants[int(rng.integers(len(variants)))]:
        parent = branches[origin.parent]
        place = float(rng.normal(*origin.place))
        if origin.parent == "aorta":
            from_root += MM * place
            place = parent.length - from_root
        else:
            place = parent.length * min(abs(place), 1.0)
        branches[origin.vessel], knots[origin.vessel] = _grow(origin, parent, place, knots, rng, arch.calibre)
    tree = VesselTree(tuple(branches.values()))
    try:
        for name in tree.names:
            tree.ostium(name)
    except ValueError:
        return None
    return tree


def _grow(
    origin: Origin, parent: Branch, arc: float, knots: dict[str, Knot], rng: np.random.Generator, calibre: float
) -> tuple[Branch, Knot]:
    """The vessel of an origin at an arc length (m) along its parent, and its last knot."""
    course = draw_course(origin.course, parent.point_at(arc), rng, parent=knots.get(origin.parent), calibre=calibre)
    points, radius = course_curve(course)
    end = origin.vessel not in TRUNKS
    return Branch(origin.vessel, points, radius, parent.name, arc, open_end=end), course[-1]


def _tightest(branch: Branch) -> float:
    """Largest curvature times radius, away from the ends."""
    turn = np.linalg.norm(np.gradient(branch.tangents, branch.arc, axis=0), axis=1)
    return float(np.max((turn * branch.radius)[5:-5]))
