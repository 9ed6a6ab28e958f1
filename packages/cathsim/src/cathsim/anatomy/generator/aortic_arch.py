"""Aortic arch generator: from measured parameters to a vessel tree, the aorta with its branches to head and arms."""

from __future__ import annotations

import math
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
    origin = _origin_on_aorta(aorta, origins["bca"])
    bca = _trunk(parameters, origin, rng)
    rsa = _right_subclavian(parameters, bca, rng)
    rcca = _right_carotid(parameters, bca, rng)
    if parameters.bovine:
        # A common origin: the left carotid leaves the trunk just above the aorta.
        arc = float(bca.arc[np.searchsorted(bca.arc, origin.depth + 0.008)])
        origin = _Origin(bca.point_at(arc), _unit(0.72, 0.25, 0.65), parameters.bca_diameter / 2, arc)
    else:
        origin = _origin_on_aorta(aorta, origins["lcca"])
    lcca = _left_carotid(parameters, origin, rng)
    lsa = _left_subclavian(parameters, _origin_on_aorta(aorta, origins["lsa"]), rng)
    return [bca, rsa, rcca, lcca, lsa]


def _origin_on_aorta(aorta: Aorta, ostium: int) -> _Origin:
    """That of a branch whose ostium lies at a point of the aorta.

    On the slopes of the arch it starts below its ostium, so that it leaves obliquely upwards.
    """
    lower = _LEAN * aorta.radius[ostium] * (1 - aorta.outward[ostium, 2]) / STEP
    index = ostium - round(float(np.sign(aorta.tangents[ostium, 2]) * lower))
    way = aorta.outer_wall[ostium] - aorta.points[index]
    depth = float(np.linalg.norm(way))
    return _Origin(aorta.points[index], way / depth, depth, aorta.arc_of(index))


def _trunk(parameters: ArchParameters, origin: _Origin, rng: np.random.Generator) -> Branch:
    depth, outward = origin.depth, origin.outward
    length = depth + parameters.trunk_length
    leave = _leaning(parameters.bca_takeoff, [-0.95, 0.30])
    steeper = _leaning(0.55 * parameters.bca_takeoff, [-0.9, 0.45])
    wide, narrow = parameters.bca_diameter / 2, _trunk_end(parameters)
    return grow_branch(
        "bca",
        origin.start,
        [(0.0, outward), (0.5 * depth, outward), (depth + 0.012, leave), (length, steeper)],
        [(0.0, wide), (depth, wide), (depth + 0.018, narrow), (0.2, narrow)],
        length,
        parent="aorta",
        parent_arc=origin.arc,
        winding_amplitude=0.5 * parameters.branch_tortuosity,
        rng=rng,
        open_end=False,
    )


def _right_subclavian(parameters: ArchParameters, bca: Branch, rng: np.random.Generator) -> Branch:
    radius = 0.36 * parameters.lsa_diameter
    return grow_branch(
        "rsa",
        bca.points[-1],
        [
            (0.0, bca.tangents[-1]),
            (0.012, _unit(-0.75, 0.25, 0.60)),
            (0.028, _unit(-0.92, 0.10, 0.38)),
            (0.040, _unit(-0.95, -0.20, -0.15)),
        ],
        [(0.0, 0.92 * _trunk_end(parameters)), (0.012, radius), (0.05, 0.95 * radius)],
        0.040,
        parent="bca",
        parent_arc=bca.length,
        winding_amplitude=0.0,
        rng=rng,
    )


def _right_carotid(parameters: ArchParameters, bca: Branch, rng: np.random.Generator) -> Branch:
    radius = _carotid(parameters)
    length = max(0.046, parameters.carotid_length - 0.9 * parameters.trunk_length)
    return grow_branch(
        "rcca",
        bca.points[-1],
        [
            (0.0, bca.tangents[-1]),
            (0.014, _unit(0.06, 0.12, 1.0)),
            (0.6 * length, _unit(0.05, 0.16, 1.0)),
            (length, _unit(-0.10, 0.10, 1.0)),
        ],
        [(0.0, 0.85 * _trunk_end(parameters)), (0.014, radius), (length, 0.95 * radius)],
        length,
        parent="bca",
        parent_arc=bca.length,
        winding_amplitude=parameters.branch_tortuosity,
        rng=rng,
    )


def _left_carotid(parameters: ArchParameters, origin: _Origin, rng: np.random.Generator) -> Branch:
    depth, outward = origin.depth, origin.outward
    length = depth + parameters.carotid_length
    leave = _leaning(parameters.lcca_takeoff, [0.9, 0.1])
    wide, radius = parameters.lcca_diameter / 2, _carotid(parameters)
    return grow_branch(
        "lcca",
        origin.start,
        [
            (0.0, outward),
            (0.5 * depth, outward),
            (depth + 0.010, leave),
            (depth + 0.5 * parameters.carotid_length, _unit(0.04, 0.16, 1.0)),
            (length, _unit(0.06, 0.05, 1.0)),
        ],
        [(0.0, wide), (depth, wide), (depth + 0.014, radius), (length, 0.95 * radius)],
        length,
        parent="bca" if parameters.bovine else "aorta",
        parent_arc=origin.arc,
        winding_amplitude=parameters.branch_tortuosity,
        rng=rng,
    )


def _left_subclavian(parameters: ArchParameters, origin: _Origin, rng: np.random.Generator) -> Branch:
    depth, outward = origin.depth, origin.outward
    length = depth + parameters.subclavian_length
    leave = _leaning(parameters.lsa_takeoff, [0.75, 0.55])
    wide, narrow = parameters.lsa_diameter / 2, 0.37 * parameters.lsa_diameter
    return grow_branch(
        "lsa",
        origin.start,
        [
            (0.0, outward),
            (0.5 * depth, outward),
            (depth + 0.010, leave),
            (depth + 0.40 * parameters.subclavian_length, _unit(0.30, 0.12, 0.94)),
            (depth + 0.75 * parameters.subclavian_length, _unit(0.80, -0.10, 0.55)),
            (length, _unit(0.95, -0.30, -0.10)),
        ],
        [(0.0, wide), (depth, wide), (depth + 0.018, narrow), (length, 0.92 * narrow)],
        length,
        parent="aorta",
        parent_arc=origin.arc,
        winding_amplitude=0.7 * parameters.branch_tortuosity,
        rng=rng,
    )


def _trunk_end(parameters: ArchParameters) -> float:
    """m: the radius of the brachiocephalic trunk where it forks."""
    return 0.78 * parameters.bca_diameter / 2


def _carotid(parameters: ArchParameters) -> float:
    """m: the radius of both carotids behind their ostia."""
    return 0.40 * parameters.lcca_diameter


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
