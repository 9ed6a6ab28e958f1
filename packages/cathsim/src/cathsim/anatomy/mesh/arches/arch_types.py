"""Which vessels of an arch are which: the known branching types are tried, and the one that fits best names them.

What is compared is where the vessels end, from the patient's right to the left: the right subclavian, the right
carotid, the left carotid, the left subclavian artery; the carotids run up more steeply than the subclavians.

Sources: types and their frequency, Natsis et al., Surg. Radiol. Anat. 31, 319-323, 2009; Popieluszko et al., Clin.
Anat. 31, 224-236, 2018.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise, permutations, product

import numpy as np

from cathsim.anatomy.mesh.arches.subtrees import RIGHT, Subtree, choices

CAROTID_TRUNK, SUBCLAVIAN_TRUNK, LEFT_TRUNK = "carotid_trunk", "subclavian_trunk", "left_trunk"
_FROM_RIGHT = {"rsa": 0.0, RIGHT: 0.5, "rcca": 1.0, "lcca": 2.0, "vertebral_left": 2.5, "lsa": 3.0}
_CAROTIDS, _SUBCLAVIANS = ("rcca", "lcca"), ("rsa", "lsa")

# Branches of the aorta from the heart on, and how much speaks against a type before anything is measured.
_TYPES: tuple[tuple[tuple[tuple[str, ...], ...], float], ...] = (
    ((("rsa", "rcca"), ("lcca",), ("lsa",)), 0.0),
    (((RIGHT,), ("lcca",), ("lsa",)), 0.1),
    ((("rsa", "rcca", "lcca"), ("lsa",)), 0.7),
    (((RIGHT, "lcca"), ("lsa",)), 0.8),
    ((("rsa", "rcca"), ("lcca",), ("vertebral_left",), ("lsa",)), 1.3),
    (((RIGHT,), ("lcca",), ("vertebral_left",), ("lsa",)), 1.4),
    (((RIGHT, "lcca"), ("vertebral_left",), ("lsa",)), 2.2),
    ((("rsa",), ("rcca",), ("lcca",), ("lsa",)), 1.3),
    ((("rcca",), ("lcca",), ("lsa",), ("rsa",)), 1.3),
    ((("rcca", "lcca"), ("lsa",), ("rsa",)), 1.6),
    ((("rsa",), ("rcca", "lcca"), ("lsa",)), 1.5),
    ((("rcca", "lcca"), ("rsa", "lsa")), 2.0),
    ((("rsa", "rcca"), ("lcca", "lsa")), 1.8),
    (((RIGHT,), ("lcca", "lsa")), 1.9),
    ((("rsa", "rcca"), ("lsa",)), 2.2),
    # of two, the second is rather the last: a carotid artery out of the trunk that is cut off is more frequent
    (((RIGHT,), ("lsa",)), 2.2),
    ((("rsa", "rcca"), ("lcca",)), 2.3),
    (((RIGHT,), ("lcca",)), 2.4),
    ((("rsa", "rcca", "lcca", "lsa"),), 2.5),
    ((("rsa", "rcca"),), 2.5),
    (((RIGHT,),), 2.5),
)
MIRRORED = 1.2  # what speaks against a mirror image
_AT_ONCE, _NEARLY = 6e-3, 10e-3  # m along the aorta within which the order of two take-offs is open, or may be wrong
_ASIDE = 12e-3  # m of difference from side to side that is a clear one
_OF_TRUNK = 8e-3  # m to the left of a trunk's origin, between its vessels of the right and of the left side
_TRUNK, _LATE_TRUNK = 58e-3, 75e-3  # m: longer, a brachiocephalic trunk usually, or certainly, has parted
_CAROTID = 38e-3  # m: shorter, a common carotid artery has not yet
_MOST = 7  # vessels that are tried


@dataclass(frozen=True)
class Reading:
    """One way to name the branches of an arch."""

    score: float
    names: tuple[tuple[Subtree, str], ...]  # of the parts that are named; RIGHT stands for a whole trunk
    mirrored: bool

    @property
    def in_words(self) -> str:
        """The names in the order of the branches."""
        return ", ".join("bca" if name == RIGHT else name for _, name in self.names)


def read_arch(parts: Sequence[Subtree], *, sides_known: bool) -> list[Reading]:
    """Names the branches of an arch in every way that the known types allow, the likeliest first.

    Args:
        parts: branches of the aorta that run to head and arms; patient's frame, x to the left, z up.
        sides_known: the frame is known, so that a mirror image is none.
    """
    parts = sorted(parts, key=lambda part: -part.radius)[:_MOST]
    parts.sort(key=lambda part: -part.vessel.start)
    readings = []
    for groups, against in _TYPES:
        for chosen in combinations(parts, len(groups)):
            dropped = [part for part in parts if part not in chosen]
            loss = sum(_weight(part, chosen) for part in dropped)
            for order in _orders(chosen):
                for names in _assignments(order, groups):
                    fit = _fit(names) - _against(order, groups) - _left_over(order, names) - against - loss
                    for mirrored in (False,) if sides_known else (False, True):
                        side = _sides(names, order, groups, -1.0 if mirrored else 1.0)
                        readings.append(Reading(fit + side - MIRRORED * mirrored, names, mirrored))
    return sorted(readings, key=lambda reading: -reading.score)


def _orders(subtrees: Sequence[Subtree]) -> Iterator[tuple[Subtree, ...]]:
    """Orders along the aorta; vessels that leave it at about one place may come in either."""
    yield tuple(subtrees)
    for k in range(len(subtrees) - 1):
        if abs(subtrees[k].vessel.start - subtrees[k + 1].vessel.start) < _NEARLY:
            yield (*subtrees[:k], subtrees[k + 1], subtrees[k], *subtrees[k + 2 :])


def _assignments(
    order: Sequence[Subtree], groups: Sequence[tuple[str, ...]]
) -> Iterator[tuple[tuple[Subtree, str], ...]]:
    """All ways to give each group's names to parts of its branch."""
    ways: list[list[tuple[tuple[Subtree, str], ...]]] = []
    for part, group in zip(order, groups, strict=True):
        ways.append(
            [
                tuple(zip(arranged, group, strict=True))
                for some in choices(part, len(group))
                for arranged in permutations(some)
            ]
        )
    for combination in product(*ways):
        yield tuple(pair for group in combination for pair in group)


def _sides(
    names: Sequence[tuple[Subtree, str]], order: Sequence[Subtree], groups: Sequence[tuple[str, ...]], sign: float
) -> float:
    """How well the ends lie from right to left (up to 4), and those of a trunk to their own side of it."""
    across = {name: sign * float(part.tip[0]) for part, name in names}
    pairs = [(a, b) for a, b in permutations(across, 2) if _FROM_RIGHT[a] < _FROM_RIGHT[b]]
    agreement = [math.tanh((across[b] - across[a]) / _ASIDE) for a, b in pairs]
    score = 4.0 * float(np.mean(agreement)) if agreement else 0.0
    for trunk, group in zip(order, groups, strict=True):
        for name in group if len(group) > 1 else ():
            leftward = across[name] - sign * float(trunk.base[0]) - _OF_TRUNK
            score += 0.35 * math.tanh(leftward / _ASIDE) * (1.0 if name in ("lcca", "lsa") else -1.0)
    return score


def _fit(names: Sequence[tuple[Subtree, str]]) -> float:
    """How much steeper the carotids rise (up to 1), and whether widths and lengths are those of the vessels."""
    by_name = {name: part for part, name in names}
    rises, weights = [], []
    for up, aside in product(_CAROTIDS, _SUBCLAVIANS):
        if up in by_name and aside in by_name:
            first, second = by_name[up], by_name[aside]
            rises.append(math.tanh((_rise(first) - _rise(second)) / 0.25))
            weights.append(min(_length(first), _length(second)) / (min(_length(first), _length(second)) + 25e-3))
    score = float(np.dot(rises, weights) / len(rises)) if rises else 0.0
    if RIGHT in by_name:
        part = by_name[RIGHT]
        if part.length > _TRUNK and not part.daughters:
            score -= 1.2  # a brachiocephalic trunk parts after 50 mm
        if len(part.leaves) > 1:
            score -= 0.6
        others = [other.radius for other, name in names if name in ("lcca", "lsa", "vertebral_left")]
        score += 0.5 * math.tanh(math.log(part.radius / float(np.mean(others))) / 0.3) if others else 0.0
    if "vertebral_left" in by_name:
        others = [by_name[name].radius for name in ("lcca", "lsa") if name in by_name]
        score += 0.7 * math.tanh(math.log(float(np.mean(others)) / by_name["vertebral_left"].radius) / 0.2)
    for part, name in names:
        if name != RIGHT and part.daughters:
            near = part.length < _CAROTID and name in _CAROTIDS
            even = min(leaf.radius for leaf in part.leaves) > 0.6 * max(leaf.radius for leaf in part.leaves)
            score -= 1.4 if near and even else 0.25
    return score


def _against(order: Sequence[Subtree], groups: Sequence[tuple[str, ...]]) -> float:
    """What speaks against trunks that part very late, and against an order of take-offs that is not quite theirs."""
    loss = 0.0
    for part, group in zip(order, groups, strict=True):
        if len(group) > 1 and part.length > _LATE_TRUNK:
            loss += 1.5
    for first, second in pairwise(order):
        apart = second.vessel.start - first.vessel.start  # positive where they come the other way round
        loss += 0.5 * max(math.tanh(apart / 4e-3), 0.0) + (0.6 if apart > _AT_ONCE else 0.0)
    return loss


def _left_over(order: Sequence[Subtree], names: Sequence[tuple[Subtree, str]]) -> float:
    """What speaks against leaving out ends within the branches that are named."""
    named = [part for part, _ in names]
    taken = {id(leaf) for part in named for leaf in part.leaves}
    left = [leaf for part in order for leaf in part.leaves if id(leaf) not in taken]
    return sum(_weight(leaf, [part.main_leaf for part in named]) for leaf in left)


def _weight(part: Subtree, subtrees: Sequence[Subtree]) -> float:
    """What speaks against leaving a vessel out: little for a thin or a short one."""
    ratio = part.radius / float(np.median([other.radius for other in subtrees]))
    return 0.2 + 1.3 * float(np.clip((ratio - 0.4) / 0.4, 0.0, 1.0)) * min(_length(part) / 25e-3, 1.0)


def _rise(part: Subtree) -> float:
    way = part.tip - part.base
    return float(way[2] / max(float(np.linalg.norm(way)), 1e-9))


def _length(part: Subtree) -> float:
    return float(np.linalg.norm(part.tip - part.base))
