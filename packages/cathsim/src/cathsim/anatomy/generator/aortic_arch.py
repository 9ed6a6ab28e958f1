"""Aortic arch generator: from measured parameters to a vessel tree."""

from __future__ import annotations

import math

import numpy as np

from cathsim.anatomy.generator.aorta import STRAIGHT_ENTRY, Aorta, fusiform_widening, shape_aorta
from cathsim.anatomy.generator.arch_parameters import Aneurysm, ArchParameters
from cathsim.anatomy.generator.branching import STEP
from cathsim.anatomy.generator.supra_aortic import grow_supra_aortic, locate_origins
from cathsim.anatomy.vessel_tree import Branch, VesselTree


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
    tree = VesselTree(tuple(branches))
    low = np.min([np.min(b.points - b.radius[:, None], axis=0) for b in tree], axis=0)
    high = np.max([np.max(b.points + b.radius[:, None], axis=0) for b in tree], axis=0)
    return tree.translated(-(low + high) / 2)


def _sac(aneurysm: Aneurysm, branch: Branch, aorta: Aorta, lsa_arc: float) -> Branch:
    """Pouch to one side of the aorta, a short blind branch with a round end."""
    index = int(np.clip((lsa_arc - aneurysm.distance) / STEP, STRAIGHT_ENTRY / STEP + 20, len(aorta.points) - 40))
    side = np.cross(aorta.tangents[index], aorta.outward[index])
    direction = math.cos(aneurysm.angle) * aorta.outward[index] + math.sin(aneurysm.angle) * side
    radius = min(0.9 * aorta.radius[index], 0.4 * aneurysm.length)
    reach = aorta.radius[index] + aneurysm.bulge - radius
    points = aorta.points[index] + direction * np.linspace(0, reach, 12)[:, None]
    return Branch("sac", points, np.full(12, radius), "aorta", float(branch.arc[index]), open_end=False)
