"""Names of all vessels of an aorta: by the branching type that fits best, or by labels of their places."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.centreline import arc_length
from cathsim.anatomy.mesh.arches.arch_types import (
    CAROTID_TRUNK,
    LEFT_TRUNK,
    MIRRORED,
    SUBCLAVIAN_TRUNK,
    Reading,
    read_arch,
)
from cathsim.anatomy.mesh.arches.subtrees import RIGHT, Subtree, rebuilt, subtree
from cathsim.anatomy.mesh.branches import RoughVessel, leaving, led_into, part_at, parted
from cathsim.anatomy.mesh.naming import arch_branches, has_arch
from cathsim.anatomy.vessel_names import AORTA

_RIGHT_SIDE, _LEFT_SIDE = ("bca", "rsa", "rcca"), ("lcca", "lsa")
_MOUTH = 2.0  # of its radius: a trunk of the left side's vessels that is shorter is a mouth that they share
_ALIKE = 0.6  # of score between an arch and its mirror image: below, neither looks more usual
_CLEAR = 0.7  # of score between the likeliest reading and the next: below, the names are noted as unsure

Array = NDArray[np.float64]
VERTEBRALS = {"lsa": "vertebral_left", "rsa": "vertebral_right"}
_TO_THE_HEAD = 80e-3  # m that a vertebral artery rises, and none to an arm
_CAROTIDS = {"lcca": "left", "rcca": "right"}
_COMMON, _ONWARD = 50e-3, 25e-3  # m of a common carotid artery at least, and that both it parts into rise
_BELOW = 0.4  # of the aorta's length, within which the other iliac artery leaves one that begins in the groin
_ILIAC, _DOWN = 0.5, 30e-3  # of the aorta's radius before it, at least; m that it goes down
_ARM = 0.5  # of its radius, at least that of the artery to the arm

LabelOf = Callable[[Array], Sequence[str]]
NamesAndNotes = tuple[dict[int, str], tuple[str, ...]]


def name_vessels(aorta: RoughVessel, *, sides_known: bool = False) -> NamesAndNotes:
    """Names vessels, by their `id()`, and notes what could be otherwise; the aorta is in the patient's frame.

    The vessels of the aorta are changed: a trunk ends where vessels of other names part.

    Args:
        sides_known: left and right are known, so that a mirror image is none.
    """
    names = {id(aorta): AORTA}
    notes: list[str] = []
    for child in aorta.children:  # the way of a wide branch parts from the aorta's long before it leaves its lumen
        child.clear = min(leaving(child, aorta), len(child.points) - 2)
    arch = has_arch(aorta)
    parts = {id(child): subtree(child) for child in arch_branches(aorta)} if arch else {}
    if not arch:
        notes.append("there is no arch of the aorta: its branches have numbers, and no names")
    elif sum(len(part.leaves) for part in parts.values()) == 1:  # a carotid siphon turns back, too
        notes.append("one branch alone does not show an arch: it has a number, and no name")
        parts = {}
    readings = read_arch(list(parts.values()), sides_known=sides_known)
    if readings:
        best = readings[0]
        _give_names(aorta, parts, dict(best.names), names)
        notes += _doubts(readings, list(parts.values()))
    _tell_vertebrals(aorta, names)
    _part_carotids(aorta, names)
    if readings:
        _tell_iliac(aorta, names)
    _number_others(aorta, names)
    return names, tuple(notes)


def labelled_names(aorta: RoughVessel, label_of: LabelOf) -> NamesAndNotes:
    """Names vessels, by their `id()`, by the labels at their places, and notes what labels do not say.

    Args:
        label_of: names ("" where there is none) at points (n, 3) m of the aorta's frame.
    """
    names = {id(aorta): AORTA}
    notes: list[str] = []
    parts = {id(child): subtree(child) for child in aorta.children}
    votes: list[tuple[int, str, Subtree]] = []
    for part in parts.values():
        for one in (part, *part.inner):
            labels = Counter(label for label in label_of(one.points) if label not in ("", AORTA))
            votes += [(count, label, one) for label, count in labels.items() if count >= 0.5 * labels.total()]
    part_names: dict[Subtree, str] = {}
    for _, label, one in sorted(votes, key=lambda vote: -vote[0]):
        trunk = any(other in one.inner for other in part_names) or any(one in other.inner for other in part_names)
        if label not in part_names.values() and not trunk and not (label == "bca" and _forks_into_labels(one, votes)):
            part_names[one] = label
    _give_names(aorta, parts, part_names, names)
    unnamed = _number_others(aorta, names)
    if is_mirrored(aorta):
        notes.append(
            "by its labels the file is mirrored, or its arch lies in front: left and right are those of the labels"
        )
    if unnamed:
        notes.append(f"the labels do not name {', '.join(unnamed)}")
    return names, tuple(notes)


def labelled_sides(aorta: RoughVessel, label_of: LabelOf) -> Array | None:
    """From the ends of the right side's vessels, by their labels, to the left one's, (3,) m; None without both."""
    ends: dict[bool, list[Array]] = {True: [], False: []}
    for child in aorta.children:
        for leaf in subtree(child).leaves:
            labels = Counter(label for label in label_of(leaf.points) if label not in ("", AORTA))
            name = labels.most_common(1)[0][0] if labels else ""
            if name in _RIGHT_SIDE or name.endswith("_right"):
                ends[False].append(leaf.points[-1])
            elif name in _LEFT_SIDE or name.endswith("_left"):
                ends[True].append(leaf.points[-1])
    if not (ends[True] and ends[False]):
        return None
    return np.mean(ends[True], axis=0) - np.mean(ends[False], axis=0)


def is_mirrored(aorta: RoughVessel) -> bool:
    """Whether labels and shape contradict each other: the descending aorta lies in front; patient's frame."""
    across = aorta.points[0] - aorta.points[-1]
    return bool(across[1] < -0.3 * np.linalg.norm(across[:2]))


def _forks_into_labels(trunk: Subtree, votes: Sequence[tuple[int, str, Subtree]]) -> bool:
    inner = {label for _, label, one in votes if one in trunk.inner}
    return len(inner & {"rsa", "rcca", "lcca"}) > 1


def _give_names(
    aorta: RoughVessel, parts: Mapping[int, Subtree], part_names: Mapping[Subtree, str], names: dict[int, str]
) -> None:
    """Makes vessels of the aorta's branches so that each named part is one, and names them and their trunks."""
    children = []
    for child in aorta.children:
        part = parts.get(id(child))
        if part is None:
            children.append(child)
            continue
        own = {one: name for one, name in part_names.items() if one is part or one in part.inner}
        short = set(own.values()) == {"lcca", "lsa"} and part.length < _MOUTH * part.radius
        vessel, named = rebuilt(part, own)
        if short and all(child.from_fork for child in vessel.children):  # one mouth of two vessels
            children += parted(vessel)
            named = [(named_vessel, within) for named_vessel, within in named if named_vessel is not vessel]
        else:
            children.append(vessel)
        for named_vessel, within in named:
            name = _trunk_name({own[one] for one in within})
            if name and name not in names.values():
                names[id(named_vessel)] = name
    aorta.children = children


def _tell_vertebrals(aorta: RoughVessel, names: dict[int, str]) -> None:
    """Names vertebral arteries; a subclavian artery that was followed up into one goes on to the arm instead."""
    for vessel in aorta.every:
        name = names.get(id(vessel))
        if name in VERTEBRALS and _rise(vessel) > _TO_THE_HEAD:
            arms = [child for child in vessel.children if not child.from_fork and _rise(child) < _TO_THE_HEAD / 2]
            arm = max(arms, key=lambda child: child.radius, default=None)
            beyond = 0.0 if arm is None else float(np.median(vessel.depth[arc_length(vessel.points) > arm.start]))
            if arm is not None and arm.radius > _ARM * beyond:
                names[id(led_into(vessel, arm))] = VERTEBRALS[name]
        elif name in VERTEBRALS:
            rising = [child for child in vessel.children if _rise(child) > _TO_THE_HEAD]
            if rising:
                names[id(max(rising, key=lambda child: child.radius))] = VERTEBRALS[name]


def _part_carotids(aorta: RoughVessel, names: dict[int, str]) -> None:
    """Lets a common carotid artery end where it parts into the internal one, which leads higher, and the external."""
    for vessel in aorta.every:
        side = _CAROTIDS.get(names.get(id(vessel), ""), "")
        sides = [c for c in vessel.children if c.start > _COMMON and c.points[-1, 2] - c.points[0, 2] > _ONWARD]
        if not side or not sides:
            continue
        first = min(sides, key=lambda child: child.start)
        if not first.from_fork:
            if vessel.points[-1, 2] - first.points[0, 2] < _ONWARD:
                continue
            part_at(vessel, first)
        daughters = sorted((c for c in vessel.children if c.from_fork), key=lambda child: -child.points[-1, 2])
        for name, daughter in zip(("internal_carotid", "external_carotid"), daughters, strict=False):
            names[id(daughter)] = f"{name}_{side}"


def _tell_iliac(aorta: RoughVessel, names: dict[int, str]) -> None:
    """Names the other iliac artery of an aorta that begins in one: wide, and it goes down."""
    arc = arc_length(aorta.points)
    wide = [
        child
        for child in aorta.children
        if child.start < _BELOW * arc[-1]
        and _rise(child) < -_DOWN
        and child.radius > _ILIAC * float(np.median(aorta.depth[arc < child.start]))
    ]
    if wide:
        iliac = max(wide, key=lambda child: child.radius)
        left = iliac.points[-1, 0] > aorta.points[0, 0]
        names[id(iliac)] = f"iliac_{'left' if left else 'right'}"


def _rise(vessel: RoughVessel) -> float:
    return float(vessel.points[-1, 2] - vessel.points[0, 2])


def _trunk_name(names: set[str]) -> str:
    if len(names) == 1:
        return "bca" if names == {RIGHT} else next(iter(names))
    trunks = (({"rcca", "lcca"}, CAROTID_TRUNK), ({"rsa", "lsa"}, SUBCLAVIAN_TRUNK), ({"lcca", "lsa"}, LEFT_TRUNK))
    other = "bca" if names <= {RIGHT, *VERTEBRALS.values(), *_RIGHT_SIDE, *_LEFT_SIDE} else ""
    return next((trunk for of, trunk in trunks if names == of), other)


def _number_others(aorta: RoughVessel, names: dict[int, str]) -> list[str]:
    number = 1
    queue, new_names = [aorta], []
    while queue:
        vessel = queue.pop(0)
        for child in vessel.children:
            if id(child) not in names:
                names[id(child)] = f"branch_{number}"
                new_names.append(names[id(child)])
                number += 1
            queue.append(child)
    return new_names


def _doubts(readings: Sequence[Reading], parts: Iterable[Subtree]) -> list[str]:
    """Notes on what the names suppose."""
    best = readings[0]
    notes = []
    of_aorta = [name for _, name in best.names]
    part_names = dict(best.names)
    for part in parts:
        within = {part_names[one] for one in (part, *part.inner) if one in part_names}
        if "lcca" in within and within & {"rsa", RIGHT}:
            notes.append("the first branch of the arch looks like the common trunk of BCA and LCCA")
    missing = [name for name in ("lcca", "lsa") if name not in of_aorta]
    if missing:
        notes.append(f"{', '.join(missing)} not found: the arch has too few branches")
    if best.mirrored:
        notes.append(
            "the arch is the mirror image of a usual one: a right-sided arch or a mirrored file; its vessels are named "
            "as those of a usual one"
        )
    image = next((r for r in readings if r.mirrored != best.mirrored and _ends(r) != _ends(best)), None)
    if image is not None and image.mirrored and best.score - image.score < MIRRORED + _ALIKE:
        notes.append("left and right cannot be told by its shape: a mirrored file would look as usual")
    other = next((r for r in readings if _ends(r) != _ends(best)), None)
    if other is not None and best.score - other.score < _CLEAR:
        meant = "in other places" if other.in_words == best.in_words else other.in_words
        notes.append(
            f"the names are unsure: {best.in_words} is taken, {meant} could be meant; look at the picture "
            "and give names to be sure"
        )
    return notes


def _ends(reading: Reading) -> dict[int | None, str]:
    return {part.main_leaf.vessel.end: "bca" if name == RIGHT else name for part, name in reading.names}
