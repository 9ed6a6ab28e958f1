"""Random aortic arches: draws from the published spread, those that cannot be vessels refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from cathsim.anatomy.generator.arch_parameters import ArchParameters, draw_parameters
from cathsim.anatomy.vessel_tree import VesselTree, nearest_on_branch

MINIMUM_SEPARATION = 2e-3  # m of wall between the lumens of vessels that do not meet
_OSTIUM_REGION = 0.008  # m beyond an ostium within which neighbours may lie nearer
_ATTEMPTS = 200
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


def sample_parameters(rng: np.random.Generator, *, wide: bool = False) -> ArchParameters:
    """Draws a plausible aortic arch: within the published spread, buildable, no vessel running into another.

    Args:
        wide: for training: take-offs, type and windings are drawn evenly from all that can be built, and a quarter of
            the arches has a common origin of BCA and LCCA.
    """
    from cathsim.anatomy.generator.aortic_arch import build_arch

    for _ in range(_ATTEMPTS):
        parameters = draw_parameters(rng)
        if wide:
            drawn: dict[str, Any] = {name: float(rng.uniform(low, high)) for name, (low, high) in WIDE.items()}
            if rng.random() < BOVINE_SHARE:
                drawn |= {"bovine": True, "bca_diameter": float(rng.uniform(0.0145, 0.0185))}
            parameters = replace(parameters, **drawn)
        try:
            tree = build_arch(parameters)
        except ValueError:
            continue
        if separation(tree) >= MINIMUM_SEPARATION:
            return parameters
    raise RuntimeError(f"no valid arch in {_ATTEMPTS} draws; the ranges of draw_parameters do not fit together.")


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
