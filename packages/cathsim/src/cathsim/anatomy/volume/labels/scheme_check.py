"""Whether labels can be the vessels that a published scheme makes of their numbers: by size, contact and side."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.vessel_names import AORTA, PARENTS
from cathsim.anatomy.volume.labels.choice import ARCH_ZONES, Key

CELL = 2e-3  # m: places of labels are told as finely as this
_NEAR = 1e-2  # m, with cells and small gaps, within which a vessel is taken to leave another
_TAKE_OFF = 4e-3  # m beyond the least distance, within which cells belong to a take-off
_RIGHT, _LEFT = ("bca", "rsa", "rcca"), ("lcca", "lsa")
_FROM_ARCH = (*_RIGHT, *_LEFT, "iliac_right", "iliac_left")  # vessels of which one at least hangs on the aorta

Array = NDArray[np.float64]


def misfit(scheme: str, vessels: Mapping[Key, str], places: Mapping[Key, Array], sizes: Mapping[Key, int]) -> str:
    """Why labels cannot be the vessels that a scheme makes of them, for a message; empty if they can.

    Args:
        scheme: as `choose_labels` names it.
        vessels: of every label, as the scheme has it.
        places: (n, 3) m, left, posterior and superior, of each label's voxels or of cells of `CELL` that hold some.
        sizes: voxels of each label.
    """
    if AORTA not in vessels.values():
        return "none would be the aorta"
    held = {name: sum(sizes[key] for key in vessels if vessels[key] == name) for name in vessels.values()}
    largest = max(held, key=lambda name: held[name])
    if largest != AORTA:
        return f"the {largest} would be larger than the aorta"
    clouds = {name: np.concatenate([places[k] for k in vessels if vessels[k] == name]) for name in held}
    first = [name for name in _FROM_ARCH if name in clouds]
    if first and not any(_hangs(name, clouds) for name in first):
        return f"{', '.join(first)} would not touch the aorta"
    if scheme == "AortaSeg24":
        return _zones_misfit(places, sizes) or sides_exchanged(clouds)
    return ""


def sides_exchanged(clouds: Mapping[str, Array]) -> str:
    """Which vessel of the left side lies to the right of one of the right side, for a message; empty where none does.

    Args:
        clouds: (n, 3) m, left, posterior and superior, by vessel.
    """
    for right in _RIGHT:
        for left in _LEFT:
            if right in clouds and left in clouds and clouds[left][:, 0].mean() < clouds[right][:, 0].mean():
                return f"the {left} would lie to the patient's right of the {right}"
    return ""


def _hangs(name: str, clouds: Mapping[str, Array]) -> bool:
    parents = [parent for parent in (AORTA, *PARENTS.get(name, ())) if parent in clouds]
    return any(_distance(clouds[name], clouds[parent]).min() < _NEAR for parent in parents)


def _zones_misfit(places: Mapping[Key, Array], sizes: Mapping[Key, int]) -> str:
    """Why labels are no zones of the arch with its branches: each branch leaves its own zone, zones are wide."""
    zones = {key: places[key] for key in places if key[1] in ARCH_ZONES}
    branches = {key: places[key] for key in places if key[1] in (4, 6)}
    for key, branch in branches.items():
        away = {zone[1]: _distance(branch, cloud) for zone, cloud in zones.items()}
        least = np.min(list(away.values()), axis=0)
        foot = least <= least.min() + _TAKE_OFF
        if 1 in away and np.mean(away[1][foot] <= least[foot]) > 0.5:
            return f"label {key[1]} leaves label 1, not the zone of the arch behind it"
    wide = {key[1]: _section(places[key], sizes[key]) for key in (*zones, *branches)}
    for stretch in (3, 5):
        for number in (4, 6):
            if stretch in wide and number in wide and wide[stretch] < wide[number]:
                return f"label {stretch} is no stretch of the arch: it is thinner than label {number}"
    return ""


def _section(cloud: Array, size: int) -> float:
    """Voxels per m of a label's greatest extent: its mean section, in a unit that all labels of a volume share."""
    offset = cloud - cloud.mean(axis=0)
    axis = np.linalg.svd(offset, full_matrices=False)[2][0]
    return size / (float(np.ptp(offset @ axis)) + CELL)


def _distance(points: Array, to: Array) -> Array:
    from scipy.spatial import cKDTree

    distance: Array = cKDTree(to).query(points)[0]
    return distance
