"""How far a wire has to turn back to enter a branch of the aorta: what makes a take-off steep."""

from __future__ import annotations

import numpy as np

from cathsim.anatomy.vessel_tree import VesselTree

DIRECTION_LENGTH = 0.012  # m of a branch beyond its ostium that give its direction


def set_back(tree: VesselTree, name: str) -> float:
    """How far the ostium of a branch lies behind the top of the arch, against the branch's own direction, m.

    A wire from the descending aorta lies along the roof of the arch, so this is how far it comes down past the ostium
    and has to come back up within the branch. It is negative where the branch leads on from the top of the arch. Of a
    branch that leaves a trunk the larger of both counts.

    Args:
        name: of a branch.

    Raises:
        ValueError: the aorta itself, or a branch that there is not.
    """
    aorta = tree.root
    chain = tree.ancestry(name)[1:] if name in tree else ()
    if not chain:
        raise ValueError(f"name must be that of a branch, {', '.join(tree.names[1:])}, got {name!r}")
    heights = aorta.points[:, 2] + aorta.radius * np.sqrt(np.maximum(1 - aorta.tangents[:, 2] ** 2, 0))
    highest = int(np.argmax(heights))
    top = np.array([*aorta.points[highest, :2], heights[highest]])
    found = []
    for vessel in chain:
        branch, begins = tree[vessel], tree.ostium_arc(vessel)
        ostium = branch.point_at(begins)
        direction = branch.point_at(min(begins + DIRECTION_LENGTH, branch.length)) - ostium
        found.append(float((top - ostium) @ direction / np.linalg.norm(direction)))
    return max(found)
