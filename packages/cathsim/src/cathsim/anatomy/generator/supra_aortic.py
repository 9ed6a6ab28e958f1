"""Branches of the aortic arch to head and arms: where they leave it and which way they run."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.centreline import arc_length
from cathsim.anatomy.generator.aorta import Aorta
from cathsim.anatomy.generator.arch_parameters import ArchParameters
from cathsim.anatomy.generator.branching import STEP, grow_branch
from cathsim.anatomy.vessel_tree import Branch

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


def grow_supra_aortic(
    parameters: ArchParameters, aorta: Aorta, origins: dict[str, int], rng: np.random.Generator
) -> list[Branch]:
    """Grows bca, rsa, rcca, lcca and lsa, each along key directions to the left (x), back (y) and up (z)."""
    wind = parameters.branch_tortuosity
    bca_origin, lcca_origin, lsa_origin = (
        diameter / 2 for diameter in (parameters.bca_diameter, parameters.lcca_diameter, parameters.lsa_diameter)
    )

    def origin(name: str) -> tuple[Array, Array, float, float]:
        """Start on the aorta's axis, direction, distance to the ostium and arc length of a branch.

        On the slopes of the arch a branch starts below its ostium, so that it leaves obliquely upwards.
        """
        ostium = origins[name]
        lower = _LEAN * aorta.radius[ostium] * (1 - aorta.outward[ostium, 2]) / STEP
        index = ostium - round(float(np.sign(aorta.tangents[ostium, 2]) * lower))
        way = aorta.outer_wall[ostium] - aorta.points[index]
        depth = float(np.linalg.norm(way))
        return aorta.points[index], way / depth, depth, aorta.arc_of(index)

    start, outward, depth, arc = origin("bca")
    leave = _leaning(parameters.bca_takeoff, [-0.95, 0.30])
    steeper = _leaning(0.55 * parameters.bca_takeoff, [-0.9, 0.45])
    trunk_end = 0.78 * parameters.bca_diameter / 2
    bca = grow_branch(
        "bca",
        start,
        [(0.0, outward), (0.5 * depth, outward), (depth + 0.012, leave), (depth + parameters.trunk_length, steeper)],
        [(0.0, bca_origin), (depth, bca_origin), (depth + 0.018, trunk_end), (0.2, trunk_end)],
        depth + parameters.trunk_length,
        parent="aorta",
        parent_arc=arc,
        winding_amplitude=0.5 * wind,
        rng=rng,
        open_end=False,
    )
    fork, onward = bca.points[-1], bca.tangents[-1]
    rsa_radius = 0.36 * parameters.lsa_diameter
    rsa = grow_branch(
        "rsa",
        fork,
        [
            (0.0, onward),
            (0.012, _unit(-0.75, 0.25, 0.60)),
            (0.028, _unit(-0.92, 0.10, 0.38)),
            (0.040, _unit(-0.95, -0.20, -0.15)),
        ],
        [(0.0, 0.92 * trunk_end), (0.012, rsa_radius), (0.05, 0.95 * rsa_radius)],
        0.040,
        parent="bca",
        parent_arc=bca.length,
        winding_amplitude=0.0,
        rng=rng,
    )
    carotid = 0.40 * parameters.lcca_diameter
    rcca_length = max(0.046, parameters.carotid_length - 0.9 * parameters.trunk_length)
    rcca = grow_branch(
        "rcca",
        fork,
        [
            (0.0, onward),
            (0.014, _unit(0.06, 0.12, 1.0)),
            (0.6 * rcca_length, _unit(0.05, 0.16, 1.0)),
            (rcca_length, _unit(-0.10, 0.10, 1.0)),
        ],
        [(0.0, 0.85 * trunk_end), (0.014, carotid), (rcca_length, 0.95 * carotid)],
        rcca_length,
        parent="bca",
        parent_arc=bca.length,
        winding_amplitude=wind,
        rng=rng,
    )

    if parameters.bovine:
        # A common origin: the left carotid leaves the trunk just above the aorta.
        arc = bca.arc[np.searchsorted(bca.arc, depth + 0.008)]
        depth = parameters.bca_diameter / 2
        start = bca.point_at(arc)
        outward = _unit(0.72, 0.25, 0.65)
    else:
        start, outward, depth, arc = origin("lcca")
    leave = _leaning(parameters.lcca_takeoff, [0.9, 0.1])
    end = depth + parameters.carotid_length
    lcca = grow_branch(
        "lcca",
        start,
        [
            (0.0, outward),
            (0.5 * depth, outward),
            (depth + 0.010, leave),
            (depth + 0.5 * parameters.carotid_length, _unit(0.04, 0.16, 1.0)),
            (end, _unit(0.06, 0.05, 1.0)),
        ],
        [(0.0, lcca_origin), (depth, lcca_origin), (depth + 0.014, carotid), (end, 0.95 * carotid)],
        end,
        parent="bca" if parameters.bovine else "aorta",
        parent_arc=float(arc),
        winding_amplitude=wind,
        rng=rng,
    )

    start, outward, depth, arc = origin("lsa")
    leave = _leaning(parameters.lsa_takeoff, [0.75, 0.55])
    narrow = 0.37 * parameters.lsa_diameter
    end = depth + parameters.subclavian_length
    lsa = grow_branch(
        "lsa",
        start,
        [
            (0.0, outward),
            (0.5 * depth, outward),
            (depth + 0.010, leave),
            (depth + 0.40 * parameters.subclavian_length, _unit(0.30, 0.12, 0.94)),
            (depth + 0.75 * parameters.subclavian_length, _unit(0.80, -0.10, 0.55)),
            (end, _unit(0.95, -0.30, -0.10)),
        ],
        [(0.0, lsa_origin), (depth, lsa_origin), (depth + 0.018, narrow), (end, 0.92 * narrow)],
        end,
        parent="aorta",
        parent_arc=arc,
        winding_amplitude=0.7 * wind,
        rng=rng,
    )
    return [bca, rsa, rcca, lcca, lsa]


def _leaning(angle: float, horizontal: list[float]) -> Array:
    """Unit vector at an angle to the superior axis, leaning towards a horizontal direction."""
    aside = np.array([*horizontal, 0.0])
    return math.cos(angle) * _UP + math.sin(angle) * aside / np.linalg.norm(aside)


def _unit(x: float, y: float, z: float) -> Array:
    vector = np.array([x, y, z])
    return vector / np.linalg.norm(vector)
