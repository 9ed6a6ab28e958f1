"""Failure modes of a navigation: the tip's path compared with the branches of the anatomy.

The mode is where the tip was for most of the last third of a failed trial:

wrong branch    inside a branch that is not on the way to the target
overshoot       in the aorta, more than 10 mm past the take-off of the first branch on the way, towards the heart
stuck           anywhere else: in the aorta before the take-off or at it, or in the right branch, short of the target

A trial that the simulator gave up counts as aborted. A tip is inside a branch when it lies outside the aorta's tube and
nearer to that branch's centreline than to any other's, both measured in radii.
"""

from __future__ import annotations

from collections import Counter

import numpy as np

from cathsim.anatomy import Phantom

WRONG_BRANCH, OVERSHOOT, STUCK, ABORTED = "wrong_branch", "overshoot", "stuck", "aborted"
MODES = (WRONG_BRANCH, OVERSHOOT, STUCK, ABORTED)
PAST = 0.010  # m along the aorta
AORTA_TUBE = 1.05  # radii: as far as that a tip still lies in the aorta
_LAST_PART = 1 / 3  # of the trial


def places(phantom: Phantom, tips: np.ndarray) -> tuple[list[str], np.ndarray]:
    """Where tips are.

    Args:
        tips: (n, 3) m.

    Returns:
        The name of the branch that each is in, and (n,) its place along the aorta, m from the aorta's first point.
    """
    tree = phantom.tree
    root = tree.root
    names, relative = [], []
    along = np.zeros(len(tips))
    for branch in tree.branches:
        apart = np.linalg.norm(tips[:, None] - branch.points[None], axis=2) / branch.radius
        names.append(branch.name)
        relative.append(apart.min(axis=1))
        if branch is root:
            along = branch.arc[apart.argmin(axis=1)]
    distance = np.stack(relative)
    distance[names.index(root.name), distance[names.index(root.name)] <= AORTA_TUBE] = -1.0
    return [names[index] for index in distance.argmin(axis=0)], along


def failure_mode(phantom: Phantom, target: str, tips: np.ndarray, *, steps_allowed: int, entry: str) -> str:
    """Why a trial failed.

    Args:
        target: that was not reached.
        tips: (steps + 1, 3) m, way of the tip.
        steps_allowed: of the trial; one that ended before was given up by the simulator.
        entry: where the wire came in.

    Returns:
        One of `MODES`.
    """
    if len(tips) - 1 < steps_allowed:
        return ABORTED
    tree, root = phantom.tree, phantom.tree.root
    way = tree.ancestry(phantom.target(target).branch)
    last = tips[-max(1, round(_LAST_PART * len(tips))) :]
    branches, along = places(phantom, last)
    # towards the heart is away from a descending entry
    came_in = phantom.entry(entry).position
    forwards = 1.0 if np.linalg.norm(root.points[0] - came_in) < np.linalg.norm(root.points[-1] - came_in) else -1.0
    take_off = tree[way[1]].parent_arc if len(way) > 1 else root.length
    votes = Counter[str]()
    for name, place in zip(branches, along, strict=True):
        if name not in way:
            votes[WRONG_BRANCH] += 1
        elif name == root.name and forwards * (place - take_off) > PAST:
            votes[OVERSHOOT] += 1
        else:
            votes[STUCK] += 1
    return votes.most_common(1)[0][0]
