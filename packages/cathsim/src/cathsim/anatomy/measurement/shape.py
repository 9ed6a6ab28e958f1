"""An aortic arch in numbers: diameters along it, take-off and spacing of its branches, bends, sections, wall."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.centreline import arc_length, resampled, smoothed
from cathsim.anatomy.measurement.sections import cut_sections, ostium_place
from cathsim.anatomy.measurement.take_off import DIRECTION_LENGTH, set_back
from cathsim.anatomy.phantom import Phantom
from cathsim.anatomy.vessel_tree import Branch, VesselTree

SUPRA_AORTIC = ("bca", "lcca", "lsa")
BEYOND_OSTIUM = 0.015  # m, where a branch's own diameter is read, past the flare
CURVATURE_WIDTH = 6e-3  # m, deviation of the Gaussian that smooths a centreline before it is bent
ISTHMUS, DESCENDING = 0.012, 0.060  # m of aorta beyond the last ostium
_LEAST_WAY = 0.02  # m of a branch beyond its ostium below which it has no tortuosity

Array = NDArray[np.float64]


def measure_shape(phantom: Phantom) -> dict[str, float]:
    """Measures a phantom's arch; NaN where a branch, or enough of it, is missing.

    Returns:
        By name with the unit: diameters (mm) of the aorta at its root (10 mm from the end), ascending (half way to the
        first ostium), in the mid arch (between the outermost ostia), isthmus and descending (12 and 60 mm beyond the
        last ostium), and of the branches 15 mm beyond their ostia or half way to their ends; width of the arch between
        its limbs and heights over both ends (mm); drop of the arch's top to the first ostium in diameters of the LCCA;
        take-off of the branches from the superior axis and from the aorta's centreline (degrees), and how far they are
        set back behind the arch's top (mm, `set_back`); spacing of their ostia along the aorta (mm); tortuosity (length
        over chord, less 1) of the descending aorta and of the branches; tightest bend in aortic diameters, and mean
        radius of the bends (mm); median and 95th percentile of the aorta's ellipticity; roughness (mm) of the aorta's
        wall and of its branches'.
    """
    tree, aorta = phantom.tree, phantom.tree.root
    sections = cut_sections(phantom, aorta.name)
    places = {b.name: ostium_place(phantom, b.name) for b in tree if b.parent == aorta.name and b.name != "sac"}
    first, last = max(places.values(), default=math.nan), min(places.values(), default=math.nan)
    found = {
        "root_diameter_mm": 1e3 * sections.diameter_at(aorta.length - 0.010),
        "ascending_diameter_mm": 1e3 * sections.diameter_at((aorta.length + first) / 2),
        "mid_arch_diameter_mm": 1e3 * sections.diameter_at((first + last) / 2, (first - last) / 2),
        "isthmus_diameter_mm": 1e3 * sections.diameter_at(last - ISTHMUS),
        "descending_diameter_mm": 1e3 * sections.diameter_at(last - DESCENDING),
    }
    found |= _limbs(aorta)
    rough = []
    for name in SUPRA_AORTIC:
        found |= _branch(phantom, name, places)
        if name in tree:
            rough.append(cut_sections(phantom, name).roughness())
    for one, other in itertools.pairwise(SUPRA_AORTIC):
        spacing = places.get(one, math.nan) - places.get(other, math.nan)
        found[f"{one}_{other}_spacing_mm"] = 1e3 * spacing
    found["arch_drop_lcca_diameters"] = _drop(tree, first, found["lcca_diameter_mm"])
    stretch = aorta.points[(aorta.arc >= 0.005) & (aorta.arc <= last)]
    found["descending_tortuosity"] = tortuosity(stretch)
    whole = sections.whole
    curvature = centreline_curvature(aorta.points)
    bent = curvature(sections.arc)
    found["tightest_bend_diameters"] = float(1 / np.max((bent * sections.diameter)[whole])) if whole.any() else math.nan
    found["mean_bend_radius_mm"] = 1e3 / float(bent.mean())
    ellipticity = sections.ellipticity[whole]
    found["ellipticity_median"] = float(np.median(ellipticity)) if whole.any() else math.nan
    found["ellipticity_largest"] = float(np.percentile(ellipticity, 95)) if whole.any() else math.nan
    found["aorta_roughness_mm"] = 1e3 * sections.roughness()
    known = [value for value in rough if math.isfinite(value)]
    found["branch_roughness_mm"] = 1e3 * float(np.mean(known)) if known else math.nan
    return found


def tortuosity(points: Array) -> float:
    """Length of a polyline (n, 3) m over the distance of its ends, less 1; NaN below 20 mm."""
    length = float(arc_length(points)[-1]) if len(points) > 1 else 0.0
    if length < _LEAST_WAY:
        return math.nan
    return length / float(np.linalg.norm(points[-1] - points[0])) - 1


def centreline_curvature(points: Array) -> Callable[[Array], Array]:
    """Curvature (1/m) of a smoothed centreline as a function of arc length (m)."""
    line = smoothed(resampled(points, 1e-3), CURVATURE_WIDTH)
    arc = arc_length(line)
    tangents = np.gradient(line, arc, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    bend = np.linalg.norm(np.gradient(tangents, arc, axis=0), axis=1)
    stretch = arc_length(points)[-1] / arc[-1]

    def curvature(at: Array) -> Array:
        return np.interp(at / stretch, arc, bend)

    return curvature


def _limbs(aorta: Branch) -> dict[str, float]:
    """Width of the arch between its limbs, 30 mm below its apex or as low as both reach, and its heights, mm."""
    apex = int(np.argmax(aorta.points[:, 2]))
    top = float(aorta.points[apex, 2])
    heights = top - float(aorta.points[0, 2]), top - float(aorta.points[-1, 2])
    below = top - min(0.030, 0.9 * min(heights))
    descending = aorta.points[:apex][np.argmin(np.abs(aorta.points[:apex, 2] - below))] if apex else aorta.points[0]
    ascending = aorta.points[apex:][np.argmin(np.abs(aorta.points[apex:, 2] - below))]
    return {
        "arch_width_mm": 1e3 * float(np.linalg.norm((descending - ascending)[:2])),
        "descending_height_mm": 1e3 * heights[0],
        "ascending_height_mm": 1e3 * heights[1],
    }


def _branch(phantom: Phantom, name: str, places: dict[str, float]) -> dict[str, float]:
    """Diameter, take-off and tortuosity of a branch."""
    measures = ("diameter_mm", "takeoff_deg", "aorta_angle_deg", "set_back_mm", "tortuosity")
    keys = [f"{name}_{measure}" for measure in measures]
    if name not in phantom.tree:
        return dict.fromkeys(keys, math.nan)
    branch, ostium = phantom.tree[name], phantom.tree.ostium_arc(name)
    sections = cut_sections(phantom, name)
    leave = branch.point_at(min(ostium + DIRECTION_LENGTH, branch.length)) - branch.point_at(ostium)
    leave /= np.linalg.norm(leave)
    angle = math.nan
    if name in places:
        along = -phantom.tree.root.tangent_at(places[name])  # with the blood
        angle = math.degrees(math.acos(float(np.clip(leave @ along, -1, 1))))
    beyond = branch.points[branch.arc >= ostium]
    values = (
        1e3 * sections.diameter_at(ostium + min(BEYOND_OSTIUM, (branch.length - ostium) / 2)),
        math.degrees(math.acos(float(np.clip(leave[2], -1, 1)))),
        angle,
        1e3 * set_back(phantom.tree, name),
        tortuosity(beyond),
    )
    return dict(zip(keys, values, strict=True))


def _drop(tree: VesselTree, first: float, lcca_mm: float) -> float:
    """Height of the arch's top over the first ostium in diameters of the LCCA."""
    aorta = tree.root
    top = float(np.max(aorta.points[:, 2] + aorta.radius * np.sqrt(np.maximum(1 - aorta.tangents[:, 2] ** 2, 0))))
    names = [b.name for b in tree if b.parent == aorta.name and b.name != "sac"]
    if not names or not math.isfinite(lcca_mm):
        return math.nan
    nearest = max(names, key=lambda name: tree[name].parent_arc)
    return 1e3 * (top - float(tree.ostium(nearest)[2])) / lcca_mm
