"""Aortic arch generator: from measured parameters to a vessel tree, the aorta with its branches to head and arms."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.centreline import arc_length
from cathsim.anatomy.generator.aorta import STRAIGHT_ENTRY, Aorta, fusiform_widening, shape_aorta
from cathsim.anatomy.generator.arch_parameters import Aneurysm, ArchParameters
from cathsim.anatomy.generator.branching import STEP, grow_branch
from cathsim.anatomy.vessel_tree import Branch, VesselTree

_LEAN = 0.9  # how far below its ostium a branch starts on a slope, in aortic radii

Array = NDArray[np.float64]
Ways = Sequence[tuple[float, Array]]  # arc lengths (m) and unit vectors (3,)
Radii = Sequence[tuple[float, float]]  # arc lengths and radii, m
_UP = np.array([0.0, 0.0, 1.0])


def locate_origins(parameters: ArchParameters, aorta: Aorta) -> dict[str, int]:
    """Finds where BCA, LCCA and LSA leave the aorta; the height of the BCA's origin makes the arch's type.

    Returns:
        Index of the aortic point at each branch's ostium; without "lcca" for a bovine arch.

    Raises:
        ValueError: the BCA would leave at or below the root.
    """
    wall = aorta.outer_wall
    apex = int(np.argmax(wall[:, 2]))
    drop = parameters.apex_ratio * parameters.lcca_diameter
    heights = wall[apex:, 2]
    lower = np.flatnonzero(aorta.top - heights >= drop)
    if len(lower) == 0:
        raise ValueError("the BCA's origin lies below the aortic root: lower apex_ratio or raise ascending_height.")
    bca = apex + int(lower[0])
    if (len(wall) - 1 - bca) * STEP < 0.03:
        raise ValueError("the BCA's origin lies too near the aortic root: lower apex_ratio or raise ascending_height.")
    along = arc_length(wall)
    first = (parameters.bca_diameter + parameters.lcca_diameter) / 2 + parameters.bca_lcca_gap
    second = (parameters.lcca_diameter + parameters.lsa_diameter) / 2 + parameters.lcca_lsa_gap
    if parameters.bovine:
        lsa_at = along[bca] - parameters.lcca_lsa_gap - (parameters.bca_diameter + parameters.lsa_diameter) / 2
        return {"bca": bca, "lsa": int(np.searchsorted(along, lsa_at))}
    return {
        "bca": bca,
        "lcca": int(np.searchsorted(along, along[bca] - first)),
        "lsa": int(np.searchsorted(along, along[bca] - first - second)),
    }


@dataclass(frozen=True)
class _Origin:
    """Where a branch begins.

    Attributes:
        start: (3,) m, on its parent's centreline.
        outward: (3,) unit vector to its ostium.
        depth: m from the start to the ostium.
        arc: m along the parent.
    """

    start: Array
    outward: Array
    depth: float
    arc: float


def grow_supra_aortic(
    parameters: ArchParameters, aorta: Aorta, origins: dict[str, int], rng: np.random.Generator
) -> list[Branch]:
    """Grows bca, rsa, rcca, lcca and lsa, each along key directions to the left (x), back (y) and up (z)."""
    p, up_to = parameters, parameters.trunk_length
    trunk_end, carotid = 0.78 * p.bca_diameter / 2, 0.40 * p.lcca_diameter  # radii at the trunk's fork, and of carotids
    leave, steeper = _leaning(p.bca_takeoff, [-0.95, 0.30]), _leaning(0.55 * p.bca_takeoff, [-0.9, 0.45])
    origin = _origin_on_aorta(aorta, origins["bca"])
    ways, radii = [(0.012, leave), (up_to, steeper)], [(0.018, trunk_end), (0.2, trunk_end)]
    bca = _from_wall("bca", origin, p.bca_diameter, ways, radii, 0.5 * p.branch_tortuosity, rng, open_end=False)

    ways = [(0.012, _unit(-0.75, 0.25, 0.60)), (0.028, _unit(-0.92, 0.10, 0.38)), (0.040, _unit(-0.95, -0.20, -0.15))]
    arm = 0.36 * p.lsa_diameter
    rsa = _from_fork("rsa", bca, ways, [(0.0, 0.92 * trunk_end), (0.012, arm), (0.05, 0.95 * arm)], 0.0, rng)

    length = max(0.046, p.carotid_length - 0.9 * up_to)
    ways = [(0.014, _unit(0.06, 0.12, 1.0)), (0.6 * length, _unit(0.05, 0.16, 1.0)), (length, _unit(-0.10, 0.10, 1.0))]
    radii = [(0.0, 0.85 * trunk_end), (0.014, carotid), (length, 0.95 * carotid)]
    rcca = _from_fork("rcca", bca, ways, radii, p.branch_tortuosity, rng)

    if p.bovine:
        # A common origin: the left carotid leaves the trunk just above the aorta.
        arc = float(bca.arc[np.searchsorted(bca.arc, origin.depth + 0.008)])
        origin = _Origin(bca.point_at(arc), _unit(0.72, 0.25, 0.65), p.bca_diameter / 2, arc)
    else:
        origin = _origin_on_aorta(aorta, origins["lcca"])
    length = p.carotid_length
    ways = [(0.010, _leaning(p.lcca_takeoff, [0.9, 0.1])), (0.5 * length, _unit(0.04, 0.16, 1.0))]
    ways, radii = [*ways, (length, _unit(0.06, 0.05, 1.0))], [(0.014, carotid), (length, 0.95 * carotid)]
    parent = "bca" if p.bovine else "aorta"
    lcca = _from_wall("lcca", origin, p.lcca_diameter, ways, radii, p.branch_tortuosity, rng, parent=parent)

    length, arm = p.subclavian_length, 0.37 * p.lsa_diameter
    ways = [(0.010, _leaning(p.lsa_takeoff, [0.75, 0.55])), (0.40 * length, _unit(0.30, 0.12, 0.94))]
    ways += [(0.75 * length, _unit(0.80, -0.10, 0.55)), (length, _unit(0.95, -0.30, -0.10))]
    origin, radii = _origin_on_aorta(aorta, origins["lsa"]), [(0.018, arm), (length, 0.92 * arm)]
    lsa = _from_wall("lsa", origin, p.lsa_diameter, ways, radii, 0.7 * p.branch_tortuosity, rng)
    return [bca, rsa, rcca, lcca, lsa]


def _from_wall(
    name: str,
    origin: _Origin,
    diameter: float,
    ways: Ways,
    radii: Radii,
    winding: float,
    rng: np.random.Generator,
    *,
    parent: str = "aorta",
    open_end: bool = True,
) -> Branch:
    """A branch that is as wide as its ostium up to that; ways and radii are those at arc lengths (m) beyond it."""
    depth, wide = origin.depth, diameter / 2
    keys = [(0.0, origin.outward), (0.5 * depth, origin.outward), *((depth + arc, way) for arc, way in ways)]
    profile = [(0.0, wide), (depth, wide), *((depth + arc, radius) for arc, radius in radii)]
    return grow_branch(
        name,
        origin.start,
        keys,
        profile,
        keys[-1][0],
        rng=rng,
        parent=parent,
        parent_arc=origin.arc,
        winding_amplitude=winding,
        open_end=open_end,
    )


def _from_fork(name: str, trunk: Branch, ways: Ways, radii: Radii, winding: float, rng: np.random.Generator) -> Branch:
    """A branch that goes on from the end of a trunk."""
    keys = [(0.0, trunk.tangents[-1]), *ways]
    return grow_branch(
        name,
        trunk.points[-1],
        keys,
        radii,
        keys[-1][0],
        rng=rng,
        parent=trunk.name,
        parent_arc=trunk.length,
        winding_amplitude=winding,
    )


def _origin_on_aorta(aorta: Aorta, ostium: int) -> _Origin:
    """That of a branch whose ostium lies at a point of the aorta.

    On the slopes of the arch it starts below its ostium, so that it leaves obliquely upwards.
    """
    lower = _LEAN * aorta.radius[ostium] * (1 - aorta.outward[ostium, 2]) / STEP
    index = ostium - round(float(np.sign(aorta.tangents[ostium, 2]) * lower))
    way = aorta.outer_wall[ostium] - aorta.points[index]
    depth = float(np.linalg.norm(way))
    return _Origin(aorta.points[index], way / depth, depth, aorta.arc_of(index))


def _leaning(angle: float, horizontal: list[float]) -> Array:
    """Unit vector at an angle to the superior axis, leaning towards a horizontal direction."""
    aside = np.array([*horizontal, 0.0])
    return math.cos(angle) * _UP + math.sin(angle) * aside / np.linalg.norm(aside)


def _unit(x: float, y: float, z: float) -> Array:
    vector = np.array([x, y, z])
    return vector / np.linalg.norm(vector)


def build_arch(parameters: ArchParameters) -> VesselTree:
    """Builds the vessel tree of an aortic arch, centred on the origin.

    Returns:
        Branches aorta (from the descending end over the arch to the root), bca, rsa, rcca, lcca, lsa, and sac, the
        pouch of a saccular aneurysm.

    Raises:
        ValueError: the measures cannot be joined to an arch; the message says why.
    """
    rng = np.random.default_rng(parameters.winding_seed)
    aorta = shape_aorta(parameters, rng)
    origins = locate_origins(parameters, aorta)
    lsa_arc = aorta.arc_of(origins["lsa"])
    radius = aorta.radius
    if parameters.aneurysm is not None and parameters.aneurysm.kind == "fusiform":
        radius = radius + fusiform_widening(parameters.aneurysm, aorta.points, lsa_arc)
    branches = [Branch("aorta", aorta.points, radius)]
    branches += grow_supra_aortic(parameters, aorta, origins, rng)
    if parameters.aneurysm is not None and parameters.aneurysm.kind == "saccular":
        branches.append(_sac(parameters.aneurysm, branches[0], aorta, lsa_arc))
    return VesselTree(tuple(branches)).centred()


def _sac(aneurysm: Aneurysm, branch: Branch, aorta: Aorta, lsa_arc: float) -> Branch:
    """Pouch to one side of the aorta, a short blind branch with a round end."""
    index = int(np.clip((lsa_arc - aneurysm.distance) / STEP, STRAIGHT_ENTRY / STEP + 20, len(aorta.points) - 40))
    side = np.cross(aorta.tangents[index], aorta.outward[index])
    direction = math.cos(aneurysm.angle) * aorta.outward[index] + math.sin(aneurysm.angle) * side
    radius = min(0.9 * aorta.radius[index], 0.4 * aneurysm.length)
    reach = aorta.radius[index] + aneurysm.bulge - radius
    points = aorta.points[index] + direction * np.linspace(0, reach, 12)[:, None]
    return Branch("sac", points, np.full(12, radius), "aorta", float(branch.arc[index]), open_end=False)
