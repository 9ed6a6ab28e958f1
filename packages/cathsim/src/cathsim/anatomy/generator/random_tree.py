"""Random trees from the groin to the head: an arch of the arch variety, the iliac arteries below, the neck's above.

Sources: diameters of common and internal carotids, 6.5 and 5.1 mm in men, 6.1 and 4.7 mm in women: Krejza et al. 2006,
Stroke 37(4), 1103. Of vertebral arteries, 3 to 4 mm; of the abdominal aorta, 16 to 20 mm; common iliac arteries of 9 to
11 mm and 40 to 60 mm: textbook values, not looked up. Types of arches: Murray and Abdel Meguid 2023, Irish Journal of
Medical Science 192(4), 1807: a common origin in 5 to 31 %, a left vertebral artery from the arch in 0.2 to 15 %, an
aberrant right subclavian artery in 0.1 to 3 %; rare ones are drawn more often. Windings and the siphon's bends, of 5 to
8 mm radius, are chosen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy.generator.branching import STEP, grow_branch
from cathsim.anatomy.generator.scan_arch import drawn_tree
from cathsim.anatomy.generator.variety_arch import VarietyArch, build_variety_arch
from cathsim.anatomy.vessel_tree import Branch, VesselTree
from cathsim.validation import Seed, settings

Array = NDArray[np.float64]
MM = 1e-3
SIDES = {"left": 1.0, "right": -1.0}  # sign of x
ARCHES = {"I": 0.45, "II": 0.3, "V": 0.15, "VII": 0.1}  # shares of the arches' types
ARCH_VERTEBRAL = 0.15  # share of left vertebral arteries that leave the arch
NARROWEST = 1.25e-3  # m: what a grid of 1 mm resolves; drawn radii seldom lie below it
LEAST_WALL = 0.8e-3  # m between lumens of vessels that do not meet
_ATTEMPTS = 100
_STREAM = 23  # of the random numbers


@settings
class RandomTree:
    """The tree of a seed."""

    seed: Seed = 0


def build_random_tree(recipe: RandomTree) -> VesselTree:
    """Builds the vessel tree, centred on the origin.

    Returns:
        The root, aorta, begins in the external iliac artery of one side. Besides the arch's, branches are `iliac_` of
        the other side, and of both sides `internal_carotid_`, `external_carotid_` and `vertebral_`.
    """
    rng = np.random.default_rng([recipe.seed, _STREAM])

    def draw() -> VesselTree:
        kind = str(rng.choice(list(ARCHES), p=list(ARCHES.values())))
        arch = build_variety_arch(VarietyArch(kind, int(rng.integers(2**31))))
        return _with_neck(_with_iliacs(arch, rng), rng)

    tree = drawn_tree(draw, LEAST_WALL, _ATTEMPTS)
    wide = (replace(branch, radius=np.maximum(branch.radius, NARROWEST)) for branch in tree)
    return VesselTree(tuple(wide)).centred()


def _grown(
    name: str, start: Array, keys: Sequence[tuple[float, Array]], radii: Sequence[tuple[float, float]], **more: object
) -> Branch:
    """`grow_branch` by lengths and radii in mm, up to the last of the radii's places."""
    directions = [(MM * at, way / np.linalg.norm(way)) for at, way in keys]
    wide = [(MM * at, MM * radius) for at, radius in radii]
    return grow_branch(name, start, directions, wide, MM * radii[-1][0], **more)  # type: ignore[arg-type]


def _with_iliacs(arch: VesselTree, rng: np.random.Generator) -> VesselTree:
    """The arch, its aorta led down to where it forks and on into the artery of the side of access."""
    upper = arch.root
    down, first = -upper.tangents[0], float(upper.radius[0] / MM)
    access, other = rng.permutation(list(SIDES))
    length, end = rng.uniform(190, 240), rng.uniform(8, 10)
    belly = _grown(
        "aorta",
        upper.points[0],
        [(0, down), (40, np.array([rng.normal(0, 0.1), 0.15, -1])), (length, np.array([0, -0.1, -1]))],
        [(0, first), (0.5 * length, 0.5 * (first + end)), (length, end)],
        winding_amplitude=rng.uniform(1e-3, 5e-3),
        rng=rng,
    )
    fork = belly.points[-1]
    iliacs = [_iliac(str(side), fork, belly.tangents[-1], rng) for side in (access, other)]
    below = np.concatenate([iliacs[0].points[:0:-1], belly.points[:0:-1]])
    radius = np.concatenate([iliacs[0].radius[:0:-1], belly.radius[:0:-1]])
    # the root's radius may not jump from the artery's to the aorta's
    points = np.concatenate([below, upper.points])
    root = Branch("aorta", points, np.concatenate([_eased(radius, len(iliacs[0].points)), upper.radius]))
    lengthened = root.length - upper.length
    at = float(root.arc[len(iliacs[0].points) - 1])
    second = iliacs[1]
    branches = [root, Branch(second.name, second.points, second.radius, "aorta", at)]
    for one in arch.branches[1:]:
        along = one.parent_arc + (lengthened if one.parent == "aorta" else 0.0)
        branches.append(Branch(one.name, one.points, one.radius, one.parent, along, one.open_end))
    return VesselTree(tuple(branches))


def _eased(radius: Array, at: int) -> Array:
    """A radius along a vessel that changes over 16 mm about a place instead of within a step."""
    reach = round(8 * MM / STEP)
    eased = radius.copy()
    first, last = max(at - reach, 0), at + reach
    eased[first : last + 1] = np.interp(np.arange(first, last + 1), [first, last], radius[[first, last]])
    return eased


def _iliac(side: str, fork: Array, down: Array, rng: np.random.Generator) -> Branch:
    out, wide = SIDES[side], rng.uniform(4.5, 5.5)
    common, outer = rng.uniform(40, 60), rng.uniform(40, 70)
    femoral = rng.uniform(3.5, 4.3)
    keys = [
        (0, down),
        (0.4 * common, np.array([0.6 * out, 0.25, -1])),
        (common, np.array([0.55 * out, 0.35, -1])),
        (common + 0.5 * outer, np.array([0.45 * out, -0.55, -1])),
        (common + outer, np.array([0.1 * out, -0.3, -1])),
    ]
    radii = [(0, 1.1 * wide), (15, wide), (common, wide), (common + 15, 1.1 * femoral), (common + outer, femoral)]
    winding = rng.uniform(1e-3, 4e-3)
    return _grown(
        f"iliac_{side}", fork, keys, radii, parent="aorta", parent_arc=0.0, winding_amplitude=winding, rng=rng
    )


def _with_neck(tree: VesselTree, rng: np.random.Generator) -> VesselTree:
    """The tree with its carotids led on to the skull, and vertebral arteries."""
    branches = {branch.name: branch for branch in tree}
    smaller = rng.uniform(0.9, 1.05)  # of a person's vessels against the mean man's
    for side, carotid in (("left", "lcca"), ("right", "rcca")):
        branches[carotid] = common = _led_on(branches[carotid], smaller * rng.normal(3.0, 0.25), rng)
        for vessel in (_internal, _external):
            branch = vessel(side, common, smaller, rng)
            branches[branch.name] = branch
    for side, arm in (("left", "lsa"), ("right", "rsa")):
        branch = _vertebral(side, branches[arm], tree, smaller, rng)
        branches[branch.name] = branch
    return VesselTree(tuple(branches.values()))


def _led_on(carotid: Branch, radius_mm: float, rng: np.random.Generator) -> Branch:
    """A common carotid that goes on to its fork."""
    further = rng.uniform(15, 45)
    end = float(carotid.radius[-1] / MM)
    on = _grown(
        "on",
        carotid.points[-1],
        [(0, carotid.tangents[-1]), (further, np.array([np.sign(carotid.points[-1, 0]) * 0.1, 0.1, 1]))],
        [(0, end), (12, radius_mm), (further, 1.1 * radius_mm)],
        rng=rng,
    )
    whole = _joined(carotid, on)
    # narrower from 50 mm behind its beginning on
    most = np.interp(whole.arc, MM * np.array([20, 50, 1000]), np.array([2, 1, 1]) * 1.1 * MM * radius_mm)
    return replace(whole, radius=np.minimum(whole.radius, most), open_end=False)


def _joined(first: Branch, second: Branch) -> Branch:
    """A branch that goes on as another."""
    points = np.concatenate([first.points, second.points[1:]])
    return replace(first, points=points, radius=np.concatenate([first.radius, second.radius[1:]]))


def _internal(side: str, common: Branch, smaller: float, rng: np.random.Generator) -> Branch:
    """An internal carotid: straight up the neck, through the skull's base to the front, and the siphon."""
    out, radius = SIDES[side], smaller * rng.normal(2.5, 0.2)
    neck = rng.uniform(65, 90)
    bend = rng.uniform(0.85, 1.2)
    bulb = 0.9 * float(common.radius[-1] / MM)
    in_neck = _grown(
        f"internal_carotid_{side}",
        common.points[-1],
        [
            (0, common.tangents[-1] + np.array([0.25 * out, 0.25, 0])),
            (14, np.array([0.25 * out, 0.2, 1])),
            (neck, np.array([-0.2 * out, 0, 1])),
        ],
        [(0, bulb), (12, radius), (neck, 0.95 * radius)],
        parent=common.name,
        parent_arc=common.length,
        winding_amplitude=rng.uniform(0, 5e-3),
        rng=rng,
    )
    siphon = [
        (0, in_neck.tangents[-1]),
        (10, np.array([-0.8 * out, -0.7, 0.15])),
        (18, np.array([-0.6 * out, -0.8, 0.2])),
        (27, np.array([0, -0.2, 1])),
        (31, np.array([0, -0.2, 1])),
        (41, np.array([0, -1, 0.15])),
        (47, np.array([0, -1, 0.2])),
        (55, np.array([0, -0.1, 1])),
        (64, np.array([0.2 * out, bend, 0.45])),
        (73, np.array([0.3 * out, 0.2, 1])),
    ]
    radii = [(0, 0.95 * radius), (31, 0.9 * radius), (75, 0.75 * radius)]
    on = _grown("on", in_neck.points[-1], siphon, radii, rng=rng)
    return _joined(in_neck, on)


def _external(side: str, common: Branch, smaller: float, rng: np.random.Generator) -> Branch:
    out, radius = SIDES[side], smaller * rng.normal(2.0, 0.15)
    keys = [
        (0, common.tangents[-1] + np.array([-0.25 * out, -0.4, 0])),
        (14, np.array([-0.25 * out, -0.55, 1])),
        (35, np.array([0.2 * out, -0.3, 1])),
        (70, np.array([0.3 * out, 0.1, 1])),
    ]
    radii = [(0, 0.8 * float(common.radius[-1] / MM)), (12, radius), (rng.uniform(50, 70), 0.85 * radius)]
    return _grown(
        f"external_carotid_{side}",
        common.points[-1],
        keys,
        radii,
        parent=common.name,
        parent_arc=common.length,
        winding_amplitude=rng.uniform(0, 2e-3),
        rng=rng,
    )


def _vertebral(side: str, arm: Branch, tree: VesselTree, smaller: float, rng: np.random.Generator) -> Branch:
    """A vertebral artery, from the subclavian one or on the left from the arch, up the spine and about the atlas."""
    out, radius = SIDES[side], smaller * rng.uniform(1.5, 2.1)
    middle = 0.5 * (tree["lcca"].points[-1] + tree["rcca"].points[-1])
    own = (arm.arc > tree.ostium_arc(arm.name) + MM * rng.uniform(15, 25)) & (arm.arc < arm.length - 12 * MM)
    places = arm.arc[own] if own.any() else arm.arc[[-13]]
    aside = np.abs(
        arm.point_at(places)[:, 0] - middle[0] - MM * 30 * out
    )  # an aberrant artery comes from the other side
    parent, arc, leave = arm, float(places[np.argmin(aside)]), 8
    beside = {b.name for b in tree if b.parent == "aorta"}
    if side == "left" and {"lcca", "lsa"} <= beside and rng.random() < ARCH_VERTEBRAL:
        parent, arc, leave = tree.root, 0.5 * (tree["lcca"].parent_arc + tree["lsa"].parent_arc), 20
    start, up = parent.point_at(arc), rng.uniform(90, 120)
    # towards the spine, behind and to the side of the middle between both carotids, over 45 mm of height
    spine = middle + MM * np.array([22 * out, 18, 0]) - start
    way = np.array([*spine[:2], 45 * MM])
    at = leave + 18 + max(float(np.linalg.norm(way) / MM) - 18, 8)
    keys = [
        (0, np.array([0, 0.3, 1])),
        (leave, np.array([0, 0.3, 1])),
        (leave + 18, way / MM),
        (at, way / MM),
        (at + 16, np.array([0, 0, 1])),
        (at + up, np.array([0, 0, 1])),
        (at + up + 10, np.array([0.7 * out, 0.2, 0.6])),
        (at + up + 20, np.array([0.1 * out, 0.4, 1])),
        (at + up + 30, np.array([-0.6 * out, 0.75, 0.1])),
        (at + up + 42, np.array([-0.7 * out, -0.2, 0.4])),
        (at + up + 54, np.array([-0.2 * out, -0.6, 1])),
        (at + up + 68, np.array([-0.1 * out, -0.3, 1])),
    ]
    radii = [(0, 1.4 * radius), (leave + 8, radius), (at + up + 68, 0.9 * radius)]
    return _grown(
        f"vertebral_{side}",
        start,
        keys,
        radii,
        parent=parent.name,
        parent_arc=arc,
        winding_amplitude=rng.uniform(0, 2e-3),
        rng=rng,
    )
