"""Anatomy of a bare vessel tree: ends of the aorta, directions, names of the branches, targets and entries.

The aorta is the widest tube. Its branches to head and arms are known by their order along the arch, the two that a
trunk forks into by which of them runs up.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.centreline import arc_length
from cathsim.anatomy.entry import ENTRY_DEPTH, Entry
from cathsim.anatomy.mesh.branches import RoughVessel, continued
from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.phantom import END_CLEARANCE, TARGET_DISTANCE, Target
from cathsim.anatomy.vessel_tree import VesselTree

ARCH_YAW = 0.75  # rad between the arch's plane and the coronal plane
SNAP_UP, SNAP_LEFT = math.radians(20), math.radians(30)  # nearer to a file's axis than this the axis is meant
SUPRA_AORTIC = ("bca", "lcca", "lsa")
OTHER_DISTANCE = 0.030  # m beyond the ostium, in branches that the named phantoms do not have
ENTRY_CHORD = 0.010  # m of centreline that give an entry its direction: a cut end is often flared or aslant
_LEAST = 3e-3  # m beyond the ostium: nearer than this a place is no target

Array = NDArray[np.float64]


def ascending_score(aorta: RoughVessel, first_radius: float, last_radius: float) -> float:
    """How much speaks for an aorta's last end being the ascending one (positive), against its first; end radii in m."""
    score = 2.0 * math.log(last_radius / first_radius)
    if aorta.children:
        length = aorta.length
        middle = float(np.mean([child.start for child in aorta.children]))
        score += 1.0 * (2 * middle / length - 1)  # the arch's branches lie nearer to the root than to the other end
    if len(aorta.children) > 1:
        near, far = aorta.children[-1], aorta.children[0]
        score += 0.7 * math.log(near.radius / far.radius)
        score += 0.4 * float(np.clip(len(near.ends) - len(far.ends), -1, 1))
    return score


def world_rotation(aorta: RoughVessel) -> tuple[Array, bool]:
    """Rotation from the file's frame to the patient's, as far as the vessels show it.

    Up is where the limbs of the arch run; the arch's plane is taken to lie 43 degrees from the coronal one, ascending
    limb to the right and to the front. Where that comes near to the file's axes, those are meant.

    Returns:
        Rotation (3, 3) whose rows are left, posterior and superior, and whether it only exchanges axes.
    """
    points, arc = aorta.points, arc_length(aorta.points)
    descending = points[arc <= 0.3 * arc[-1]]
    middle = 0.5 * (points[0] + points[-1])
    beyond = np.mean([child.tip for child in aorta.children], axis=0) - middle
    up = 1.5 * _unit(descending[-1] - descending[0]) + _unit(beyond)
    up, snapped_up = _snap(_unit(up), SNAP_UP)
    across = points[0] - points[-1]
    across = _unit(across - (across @ up) * up)
    left = math.cos(ARCH_YAW) * across - math.sin(ARCH_YAW) * np.cross(up, across)
    snapped = False
    if snapped_up:
        left, snapped = _snap(left, SNAP_LEFT, avoid=up)
    return np.stack([left, np.cross(up, left), up]), snapped


def name_vessels(aorta: RoughVessel) -> tuple[dict[int, str], tuple[str, ...]]:
    """Names vessels, by their `id()`, and notes what could be otherwise; the aorta is in the patient's frame."""
    names = {id(aorta): "aorta"}
    notes = []
    candidates = sorted(aorta.children, key=lambda child: -child.radius)
    upward = [c for c in candidates if c.tip[2] > c.points[0][2]] or candidates
    chosen: tuple[str, ...] = SUPRA_AORTIC
    arch = sorted(upward[:3], key=lambda child: -child.start)
    if len(arch) == 2:
        carotid = _left_carotid(*arch)
        chosen = ("bca", "lcca") if carotid is None else ("bca", "lsa")
        why = "there is no third" if carotid is None else "the first looks like the common trunk of BCA and LCCA"
        notes.append(f"the arch has two branches, called {chosen[0]} and {chosen[1]}: {why}")
        if carotid is not None:
            names[id(carotid)] = "lcca"
            rest = [c for c in arch[0].children if c.from_fork and c is not carotid]
            if carotid.from_fork and len(rest) == 1:
                continued(arch[0], rest[0])
    elif len(arch) == 1:
        chosen = ("bca",)
        notes.append("the arch has one branch, called bca")
    for name, vessel in zip(chosen, arch, strict=True):
        names[id(vessel)] = name
        if name == "bca":
            _name_trunk(vessel, names)
    number = 1
    queue = [aorta]
    while queue:
        vessel = queue.pop(0)
        for child in vessel.children:
            if id(child) not in names:
                names[id(child)] = f"branch_{number}"
                number += 1
            queue.append(child)
    return names, tuple(notes)


def _left_carotid(trunk: RoughVessel, last: RoughVessel) -> RoughVessel | None:
    """The daughter of a trunk that is the left carotid: of three the leftmost, of two one that ends by the LSA."""
    daughters = [d for d in trunk.children if len(d.ends) == 1]
    if not daughters:
        return None
    leftmost = max(daughters, key=lambda d: d.tip[0])
    if len(trunk.ends) > 2:  # more than the two arteries of the right side
        return leftmost
    others = [d.tip for d in trunk.children if d is not leftmost]
    if trunk.end is not None:
        others.append(trunk.tip)
    near = min(float(np.linalg.norm(leftmost.tip - tip)) for tip in others)
    return leftmost if float(np.linalg.norm(leftmost.tip - last.tip)) < near else None


def _name_trunk(trunk: RoughVessel, names: dict[int, str]) -> None:
    """Names the subclavian and the carotid artery of the right side."""
    pair = sorted((c for c in trunk.children if len(c.ends) == 1 and id(c) not in names), key=lambda c: -c.radius)[:2]
    if len(pair) == 2:
        pair.sort(key=_rise)
        names[id(pair[0])], names[id(pair[1])] = "rsa", "rcca"
    elif len(pair) == 1 and trunk.end is not None:
        names[id(pair[0])] = "rcca" if _rise(pair[0]) > _rise(trunk) else "rsa"


def _rise(vessel: RoughVessel) -> float:
    """How steeply a vessel runs up from its start to its end."""
    return float(_unit(vessel.points[-1] - vessel.points[0])[2])


def labelled_names(
    aorta: RoughVessel, label_of: Callable[[Array], Sequence[str]]
) -> tuple[dict[int, str], tuple[str, ...]]:
    """Names vessels, by their `id()`, by the labels at their places, and notes what labels do not say.

    Args:
        label_of: names ("" where there is none) at points (n, 3) m of the aorta's frame.
    """
    names = {id(aorta): "aorta"}
    notes = []
    number = 1
    queue = [aorta]
    while queue:
        vessel = queue.pop(0)
        for child in vessel.children:
            there = Counter(label for label in label_of(child.points[child.outside :]) if label not in ("", "aorta"))
            name = next((label for label, _ in there.most_common() if label not in names.values()), "")
            if not name:
                name = f"branch_{number}"
                number += 1
                notes.append(f"the labels do not name one vessel, called {name}")
            names[id(child)] = name
            queue.append(child)
    return names, tuple(notes)


def renamed(names: dict[int, str], own: Mapping[str, str] | None) -> dict[int, str]:
    """Automatic names replaced by the user's (automatic name to own name, or None).

    Raises:
        MeshRefusedError: for a vessel that there is not, or a name used twice.
    """
    if not own:
        return names
    unknown = sorted(set(own) - set(names.values()))
    if unknown:
        raise MeshRefusedError(
            f"names refer to {', '.join(unknown)}, which was not found; found are {', '.join(names.values())}."
        )
    if own.get("aorta", "aorta") != "aorta":
        raise MeshRefusedError("the main vessel keeps its name aorta; give names to its branches only.")
    result = {vessel: own.get(name, name) for vessel, name in names.items()}
    if len(set(result.values())) < len(result):
        raise MeshRefusedError(f"names must differ, got {', '.join(result.values())}; give each branch its own.")
    return result


def ordered_names(aorta: RoughVessel, names: Mapping[int, str], own: list[str]) -> dict[str, str]:
    """The mapping from automatic names that a list of own names stands for, the aorta's branches from the heart on.

    Raises:
        MeshRefusedError: there are not as many branches.
    """
    found = [names[id(child)] for child in sorted(aorta.children, key=lambda child: -child.start)]
    if len(own) != len(found):
        raise MeshRefusedError(
            f"{len(own)} names were given for the {len(found)} branches of the aorta ({', '.join(found)}); "
            "give as many, or a mapping."
        )
    return dict(zip(found, own, strict=True))


def propose_targets(tree: VesselTree) -> tuple[dict[str, Target], tuple[str, ...]]:
    """Targets by name, one in every branch, and notes on those that were moved or left out."""
    targets, notes = {}, []
    for branch in tree.branches[1:]:
        wanted = TARGET_DISTANCE.get(branch.name, OTHER_DISTANCE)
        try:
            ostium = tree.ostium_arc(branch.name)
        except ValueError:  # it never leaves its parent's lumen
            continue
        clearance = END_CLEARANCE if branch.open_end else 0.0
        distance = min(wanted, branch.length - clearance - ostium)
        if distance < _LEAST:
            notes.append(f"no target in {branch.name}: it is only {1e3 * (branch.length - ostium):.0f} mm long")
            continue
        if distance < wanted - 1e-9:
            notes.append(
                f"target {branch.name} lies {1e3 * distance:.0f} mm up its branch instead of {1e3 * wanted:.0f}: "
                "the branch is short"
            )
        targets[branch.name] = Target(branch.name, branch.name, branch.point_at(ostium + distance), ostium + distance)
    return targets, tuple(notes)


def propose_entries(tree: VesselTree) -> dict[str, Entry]:
    """Entries "descending" and "ascending" at the two ends of the aorta."""
    aorta = tree.root
    entries = {}
    for name, near, far in (
        ("descending", ENTRY_DEPTH, ENTRY_DEPTH + ENTRY_CHORD),
        ("ascending", aorta.length - ENTRY_DEPTH, aorta.length - ENTRY_DEPTH - ENTRY_CHORD),
    ):
        position = aorta.point_at(near)
        way = aorta.point_at(far) - position
        entries[name] = Entry(name, position, way / np.linalg.norm(way))
    return entries


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
    unit: Array = vector / max(float(np.linalg.norm(vector)), 1e-12)
    return unit
