"""Anatomy of a bare vessel tree: ends of the aorta, its arch, and the patient's axes.

The aorta is the widest tube. Its branches to head and arms are known by their order along the arch, the two that a
trunk forks into by which of them runs up.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.centreline import arc_length, resampled
from cathsim.anatomy.mesh.branches import RoughVessel, leaving

ARCH_YAW = 0.75  # rad between the arch's plane and the coronal plane
SNAP_UP, SNAP_LEFT = math.radians(20), math.radians(30)  # nearer to a file's axis than this the axis is meant
_SPREAD_WEIGHT = 1.5  # of the ends' spread to one side, against the direction from limb to limb
_BELOW_ARCH = 30e-3  # m, and 2.5 radii: how far below the arch's top a last branch to head and arms may leave the aorta
_SIDES_APART = 10e-3  # m between the ends of both sides from which on labels show where left is
_WIDE_SPREAD = 20e-3  # m, deviation of the ends from their middle that shows the side well
_MAIN = 0.4  # of the widest branch's radius: narrower ones are none to head and arms
_DOWNWARD = 2e-3  # m: a vessel whose end lies further below its ostium goes downward
_STEPS = 100  # along an aorta, whose directions over tenths of it show whether there is an arch
_TURNED = math.radians(100)  # between two of them, at least: arches have 140 or more, an abdominal aorta 30
_USUAL = 3  # branches that an arch usually has
_ARCH_HIGH = 10e-3  # m that an aorta's middle lies above or below both of its ends, from which on it is an arch
_CLEARLY_FRONT = 5e-3  # m that a descending aorta lies in front of the ascending one, from which on a header is doubted

Array = NDArray[np.float64]


def ascending_score(aorta: RoughVessel, first_radius: float, last_radius: float) -> float:
    """How much speaks for an aorta's last end being the ascending one (positive), against its first; end radii in m."""
    score = 2.0 * math.log(last_radius / first_radius)  # not the branches' radii: any of them may be dilated
    # Coronary arteries, at the root, and those of the trunk say nothing of the arch's order.
    widest = max((child.radius for child in aorta.children), default=0.0)
    children = [child for child in aorta.children if child.radius > _MAIN * widest]
    if children:
        length = aorta.length
        middle = float(np.mean([child.start for child in children]))
        score += 1.0 * (2 * middle / length - 1)  # the arch's branches lie nearer to the root than to the other end
    if len(children) > 1:
        near, far = children[-1], children[0]
        score += 0.4 * float(np.clip(len(near.ends) - len(far.ends), -1, 1))
    return score


def world_rotation(aorta: RoughVessel, leftward: Array | None = None) -> tuple[Array, bool]:
    """Rotation from the file's frame to the patient's, as far as the vessels show it.

    Up is where the limbs of the arch run, or, without an arch, the aorta from its first end on. To the left lies the
    side to which the branches' ends spread, away from the ascending limb; where they hardly do, the arch's plane is
    taken to lie 43 degrees from the coronal one, ascending limb to the right and to the front. Where that comes near to
    the file's axes, those are meant.

    Args:
        leftward: (3,) from vessels that labels name as those of the right side to those of the left one, any length.

    Returns:
        Rotation (3, 3) whose rows are left, posterior and superior, and whether it only exchanges axes.
    """
    points, arc = aorta.points, arc_length(aorta.points)
    descending = points[arc <= 0.3 * arc[-1]]
    middle = 0.5 * (points[0] + points[-1])
    beyond = np.mean([child.tip for child in aorta.children], axis=0) - middle
    up = 1.5 * _unit(descending[-1] - descending[0]) + _unit(beyond)
    if not has_arch(aorta):
        up = points[-1] - points[0]
    up, snapped_up = _snap(_unit(up), SNAP_UP)
    across = points[0] - points[-1]
    across = _unit(across - (across @ up) * up)
    left = math.cos(ARCH_YAW) * across - math.sin(ARCH_YAW) * np.cross(up, across)
    left = _unit(left + _SPREAD_WEIGHT * _spread(arch_branches(aorta, up), up, left))
    if leftward is not None and np.linalg.norm(leftward - (leftward @ up) * up) > _SIDES_APART:
        left = _unit(leftward - (leftward @ up) * up)
    snapped = False
    if snapped_up:
        left, snapped = _snap(left, SNAP_LEFT, avoid=up)
    return np.stack([left, np.cross(up, left), up]), snapped


def _spread(branches: list[RoughVessel], up: Array, left: Array) -> Array:
    """Horizontal direction (3,) in which branches' ends spread most, on the side of `left`; short where they do not."""
    tips = np.array([one.points[-1] for branch in branches for one in branch.every if one.end is not None])
    if len(tips) < 2:
        return np.zeros(3)
    flat = tips - np.outer(tips @ up, up)
    flat -= flat.mean(axis=0)
    _, size, axes = np.linalg.svd(flat, full_matrices=False)
    spread = float(np.hypot(size[0], 0) - size[1]) / math.sqrt(len(tips))
    return axes[0] * np.sign(axes[0] @ left) * min(spread / _WIDE_SPREAD, 1.0)


def has_arch(aorta: RoughVessel) -> bool:
    """Whether an aorta turns back, as one with an arch does."""
    along = resampled(aorta.points, aorta.length / _STEPS)
    directions = along[_STEPS // 10 :] - along[: -(_STEPS // 10)]
    directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-12)
    return bool((directions @ directions.T).min() < math.cos(_TURNED))


def pose_doubts(aorta: Array) -> tuple[str, ...]:
    """Doubts in the axes of a file that names the patient's: the arch points to the feet, or lies in front.

    Args:
        aorta: (n, 3) m, left, posterior and superior, from the descending end to the heart's.
    """
    above = float(aorta[:, 2].max() - aorta[[0, -1], 2].max())
    below = float(aorta[[0, -1], 2].min() - aorta[:, 2].min())
    if max(above, below) < _ARCH_HIGH:
        return ()  # no arch
    height = -aorta[:, 2] if below > above else aorta[:, 2]
    top = int(np.argmax(height))
    descending = aorta[: top + 1][height[: top + 1] >= height[-1]]  # as far down as the ascending one
    in_front = aorta[top:, 1].mean() - descending[:, 1].mean() > _CLEARLY_FRONT
    seen = [("its arch points to the feet", below > above), ("its descending aorta lies in front", in_front)]
    doubts = " and ".join(words for words, is_so in seen if is_so)
    return (f"by the file's axes {doubts}: they turn or mirror the patient; check the header",) if doubts else ()


def arch_branches(aorta: RoughVessel, up: Array | None = None) -> list[RoughVessel]:
    """Branches of the aorta that run to head and arms: they leave it at the arch and end above it.

    Args:
        up: (3,) unit vector towards the head; z where it is left out.
    """
    up = np.array([0.0, 0.0, 1.0]) if up is None else up
    height = aorta.points @ up
    arc = arc_length(aorta.points)
    top = int(np.argmax(height))
    branches, low = [], []
    for child in aorta.children:
        at = int(np.argmin(np.abs(arc - child.start)))
        radius = float(aorta.depth[at])
        below = float(height[top] - height[at])
        limb = float(height[top] - (height[-1] if at > top else height[0]))
        if below > (0.75 * limb if at > top else 2.5 * radius + _BELOW_ARCH):
            continue  # a coronary artery, or one of the descending aorta
        highest = max(float((one.points @ up).max()) for one in child.every)  # an arm's artery goes down again
        ostium = child.points[leaving(child, aorta)]  # the way of a wide branch parts from the aorta's long before
        beside = float(height[np.argmin(np.linalg.norm(aorta.points - ostium, axis=1))])
        if highest >= max(min(height[at], beside) + 0.7 * radius, height[top] - radius):
            branches.append(child)
        elif (child.tip - ostium) @ up > -_DOWNWARD:
            low.append(child)
    if 0 < len(branches) < _USUAL:  # a wide vessel that is cut soon after it leaves a limb of the arch aslant
        widest = max(child.radius for child in branches)
        branches += [child for child in low if child.radius > _MAIN * widest]
        branches.sort(key=lambda child: child.start)
    return branches or [child for child in aorta.children if (child.tip - child.points[0]) @ up > 0]


def _snap(direction: Array, angle: float, avoid: Array | None = None) -> tuple[Array, bool]:
    """The file's axis nearest to a direction, if it is near."""
    weight = np.abs(direction).copy()
    if avoid is not None:
        weight[int(np.argmax(np.abs(avoid)))] = -1.0
    axis = int(np.argmax(weight))
    if abs(direction[axis]) < math.cos(angle):
        return direction, False
    return np.eye(3)[axis] * np.sign(direction[axis]), True


def _unit(vector: Array) -> Array:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)
