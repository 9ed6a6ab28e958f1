"""Vessels of arches of every branching type get their names, from any side, mirrored, and cut short."""

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cathsim.anatomy import Branch, MeshRefusedError, VesselTree
from cathsim.anatomy.centreline import arc_length
from cathsim.anatomy.generator.aortic_arch import build_arch
from cathsim.anatomy.generator.random_tree import RandomTree, build_random_tree
from cathsim.anatomy.generator.scan_arch import sample_parameters
from cathsim.anatomy.generator.variety_arch import ARCH_TYPES, VarietyArch, build_variety_arch
from cathsim.anatomy.library import NAMED
from cathsim.anatomy.mesh.arches.arch_naming import labelled_names, labelled_sides, name_vessels
from cathsim.anatomy.mesh.branches import RoughVessel, turned
from cathsim.anatomy.mesh.completion import final_names, propose_targets
from cathsim.anatomy.mesh.naming import pose_doubts, world_rotation

MIRROR = np.diag([-1.0, 1.0, 1.0])
TURN = Rotation.from_euler("xyz", [2.1, 0.4, -1.3]).as_matrix()
Array = np.ndarray


@cache
def sampled_arch(seed: int) -> VesselTree:
    return build_arch(sample_parameters(np.random.default_rng(seed)))


@cache
def variety_arch(arch_type: str, seed: int) -> VesselTree:
    return build_variety_arch(VarietyArch(arch_type=arch_type, seed=seed))


def rough_vessels(tree: VesselTree, frame: Array, shorter: float = np.inf) -> dict[str, RoughVessel]:
    """The vessels of a tree as an import finds them, before they have names; ends are numbered.

    A frame (3, 3) turns or mirrors them; where `shorter` is given, branches of the aorta end so far (m) behind their
    ostium, with all that leaves them further on.
    """
    made: dict[str, RoughVessel] = {}
    for number, branch in enumerate(tree):
        if branch.parent is not None and branch.parent not in made:
            continue
        count = len(branch.points)
        if branch.parent is not None and np.isfinite(shorter):
            if branch.parent != tree.root.name:
                continue
            count = max(int(np.searchsorted(branch.arc, tree.ostium_arc(branch.name) + shorter)), 5)
        parent = tree[branch.parent] if branch.parent else None
        fork = parent is not None and not parent.open_end and branch.parent_arc > parent.length - 2e-3
        depth = branch.radius[:count].copy()
        if parent is not None and not fork:
            depth[0] = parent.radius_at(branch.parent_arc)
        end = number if branch.open_end or np.isfinite(shorter) else None
        vessel = RoughVessel(branch.points[:count] @ frame.T, depth, end, start=branch.parent_arc, from_fork=fork)
        if branch.parent is not None:
            made[branch.parent].children.append(vessel)
            made[branch.parent].children.sort(key=lambda child: child.start)
        made[branch.name] = vessel
    return made


def found_names(aorta: RoughVessel) -> tuple[dict[int | None, str], set[str], tuple[str, ...]]:
    """The name at every end, the names of trunks, and the notes."""
    rotation, _ = world_rotation(aorta)
    aorta = turned(aorta, rotation, np.zeros(3))
    names, notes = name_vessels(aorta)
    ends = {vessel.end: names[id(vessel)] for vessel in aorta.every if vessel.end is not None}
    return ends, {names[id(vessel)] for vessel in aorta.every if vessel.end is None}, notes


def names_at_ends(made: dict[str, RoughVessel]) -> dict[int | None, str]:
    """The true name at every end."""
    return {vessel.end: name for name, vessel in made.items() if vessel.end is not None}


def test_a_bent_vessel_with_one_branch_is_no_arch():
    """As a carotid siphon with an aneurysm, or one iliac artery that leads on to the other."""
    made = rough_vessels(variety_arch("I", 1), np.eye(3))
    aorta, alone = made["aorta"], made["lcca"]
    aorta.children, alone.children = [alone], []
    ends, trunks, notes = found_names(aorta)
    assert ends == {aorta.end: "aorta", alone.end: "branch_1"}
    assert not trunks
    assert "one branch alone does not show an arch" in notes[0]


@pytest.mark.parametrize("arch_type", ARCH_TYPES)
def test_every_type_is_named_also_where_it_is_turned_or_mirrored(arch_type: str):
    for frame in (np.eye(3), TURN, MIRROR):
        made = rough_vessels(variety_arch(arch_type, 1), frame)
        ends, trunks, notes = found_names(made["aorta"])
        if arch_type == "VI" and frame is MIRROR:  # both sides leave the aorta alike
            assert any("left and right cannot be told by its shape" in note for note in notes)
            continue
        assert ends == names_at_ends(made)
        assert trunks == {name for name, vessel in made.items() if vessel.end is None}
        if frame is MIRROR:
            assert any("mirror" in note for note in notes)


def test_random_arches_are_named():
    wrong = []
    for seed in range(12):
        wide = seed % 2 == 1
        tree = build_arch(sample_parameters(np.random.default_rng(seed), wide=True)) if wide else sampled_arch(seed)
        made = rough_vessels(tree, Rotation.random(random_state=seed).as_matrix())
        if found_names(made["aorta"])[0] != names_at_ends(made):
            wrong.append(seed)
    assert wrong == []


def with_more_vessels(tree: VesselTree) -> VesselTree:
    """An arch on which coronary, intercostal, visceral and vertebral arteries hang."""
    aorta, arm = tree.root, tree["lsa"]
    more = {
        "coronary": (aorta, aorta.length - 0.012, (0.8, -0.5, -0.1), 1.8e-3),
        "celiac": (aorta, 0.02, (0.1, -1.0, -0.4), 3.0e-3),
        "renal": (aorta, 0.012, (-1.0, 0.1, -0.2), 2.8e-3),
        "intercostal": (aorta, 0.07, (0.5, 0.8, 0.3), 1.2e-3),
        "vertebral_left": (arm, min(tree.ostium_arc("lsa") + 0.03, 0.7 * arm.length), (0.0, 0.2, 1.0), 1.8e-3),
        "vertebral_right": (tree["rsa"], 0.5 * tree["rsa"].length, (0.0, 0.2, 1.0), 1.8e-3),
    }
    branches = list(tree)
    for name, (parent, arc, direction, radius) in more.items():
        unit = np.array(direction) / np.linalg.norm(direction)
        along = np.linspace(0, 0.035 + float(parent.radius_at(arc)), 30)
        points = parent.point_at(arc) + along[:, None] * unit
        branches.append(Branch(name, points, np.full(30, radius), parent.name, arc))
    return VesselTree(tuple(branches))


def test_more_vessels_do_not_shift_names():
    for seed in range(6):
        tree = with_more_vessels(sampled_arch(seed))
        made = rough_vessels(tree, np.eye(3))
        ends, _, _ = found_names(made["aorta"])
        for name in ("rsa", "rcca", "lcca", "lsa"):
            assert ends[made[name].end] == name, (seed, name)


def test_arteries_that_go_down_the_arms_are_named():
    for seed in range(6):
        made = rough_vessels(sampled_arch(seed), np.eye(3))
        for name, side in (("rsa", -1.0), ("lsa", 1.0)):
            arm = made[name]
            steps = np.arange(1, 151)[:, None] * 1e-3 * np.array([0.6 * side, 0.0, -0.8])
            arm.points = np.concatenate([arm.points, arm.points[-1] + steps])
            arm.depth = np.concatenate([arm.depth, np.full(150, arm.depth[-1])])
        ends, _, _ = found_names(made["aorta"])
        assert ends == names_at_ends(made), seed


@pytest.mark.parametrize(("mouth", "trunk"), [(0.004, None), (0.03, "left_trunk")])
def test_left_vessels_of_one_origin_are_named(mouth: float, trunk: str | None):
    """Their mouths are one where they lie side by side; where they part late, they have a trunk."""
    tree = sampled_arch(3)
    made = rough_vessels(tree, np.eye(3))
    left = made["lsa"]
    cut = int(np.searchsorted(tree["lsa"].arc, tree.ostium_arc("lsa") + mouth))
    carotid = made["lcca"].points[int(np.searchsorted(tree["lcca"].arc, tree.ostium_arc("lcca") + mouth)) :]
    common = RoughVessel(left.points[: cut + 1], left.depth[: cut + 1], None, start=left.start)
    for name, points in (("lsa", left.points[cut:]), ("lcca", np.concatenate([left.points[cut : cut + 1], carotid]))):
        made[name].points, made[name].depth = points, np.full(len(points), tree[name].radius[-1])
        made[name].start, made[name].from_fork = common.length, True
        common.children.append(made[name])
    others = [child for child in made["aorta"].children if child not in (left, made["lcca"])]
    made["aorta"].children = sorted([*others, common], key=lambda child: child.start)
    ends, trunks, _ = found_names(made["aorta"])
    for name in ("rsa", "rcca", "lcca", "lsa"):
        assert ends[made[name].end] == name
    assert trunks - {"bca"} == ({trunk} if trunk else set())


def test_a_trunk_is_as_long_as_what_stands_out_of_the_aorta():
    """The way of a wide trunk parts from the aorta's long before it leaves the aorta's lumen."""
    tried = 0
    for seed in range(8):
        made = rough_vessels(sampled_arch(seed), np.eye(3))
        aorta, trunk = made["aorta"], made["bca"]
        if trunk not in aorta.children or made["rsa"] not in trunk.children:
            continue
        stop = int(np.searchsorted(arc_length(aorta.points), trunk.start))
        before = slice(max(stop - 25, 0), stop)
        aside = np.array([0.0, 0.3, 0.0]) * aorta.depth[before, None]
        trunk.start = float(arc_length(aorta.points)[before.start])
        trunk.points = np.concatenate([aorta.points[before] + aside, trunk.points])
        trunk.depth = np.concatenate([0.7 * aorta.depth[before], trunk.depth])
        for child in trunk.children:
            child.start = trunk.length
        ends, _, _ = found_names(aorta)
        assert {made[name].end: name for name in ("rsa", "rcca", "lcca", "lsa")}.items() <= ends.items(), seed
        tried += 1
    assert tried > 3


def test_branches_that_are_cut_short_are_named_by_their_order():
    for seed in range(12):
        tree = sampled_arch(seed)
        if tree["lcca"].parent != "aorta":
            continue
        made = rough_vessels(tree, np.eye(3), shorter=0.02)
        ends, _, _ = found_names(made["aorta"])
        assert {made[name].end: name for name in ("aorta", "bca", "lcca", "lsa")}.items() <= ends.items(), seed


def test_of_two_branches_that_are_cut_short_the_second_is_the_left_subclavian():
    """The left carotid artery left the trunk, beyond where it is cut."""
    tried = 0
    for seed in range(60):
        tree = sampled_arch(seed)
        if tree["lcca"].parent != "bca":
            continue
        made = rough_vessels(tree, np.eye(3), shorter=0.015)
        ends, _, notes = found_names(made["aorta"])
        assert {made[name].end: name for name in ("aorta", "bca", "lsa")}.items() <= ends.items(), seed
        assert any("lcca not found" in note for note in notes)
        tried += 1
    assert tried > 3


def test_labels_name_vessels_and_show_the_sides():
    tree = variety_arch("I", 2)
    made = rough_vessels(tree, MIRROR)
    places = [(branch.name, branch.points @ MIRROR.T) for branch in tree]

    def label_of(points: Array) -> list[str]:
        away = np.stack([np.linalg.norm(p[None] - points[:, None], axis=2).min(axis=1) for _, p in places])
        return [places[int(k)][0] for k in np.argmin(away, axis=0)]

    leftward = labelled_sides(made["aorta"], label_of)
    assert leftward[0] < -0.02
    rotation, _ = world_rotation(made["aorta"], leftward)
    aorta = turned(made["aorta"], rotation, np.zeros(3))
    names, notes = labelled_names(aorta, lambda points: label_of(points @ rotation))
    assert set(names.values()) == set(made)
    assert any("the file is mirrored" in note for note in notes)


def test_a_trunk_of_other_arteries_than_those_of_head_and_arms_is_no_bca():
    made = rough_vessels(variety_arch("I", 2), np.eye(3))
    called = {"rsa": "internal_iliac_left", "rcca": "inferior_mesenteric"}

    def label_of(points: Array) -> list[str]:
        away = {name: np.linalg.norm(made[name].points[None] - points[:, None], axis=2).min(axis=1) for name in called}
        return [next((called[name] for name in called if away[name][k] < 1e-6), "") for k in range(len(points))]

    names, _ = labelled_names(made["aorta"], label_of)
    assert set(called.values()) <= set(names.values())
    assert "bca" not in names.values()


def _vessel(start: list[float], end: list[float], radius: float, number: int | None) -> RoughVessel:
    points = np.linspace(start, end, 40)
    return RoughVessel(points, np.full(40, radius), number)


def test_an_abdominal_aorta_stands_upright():
    """It begins in an iliac artery, which runs aslant, and its branches leave it to the front."""
    iliac = np.linspace([0.06, 0.0, -0.07], [0.0, 0.0, 0.0], 40, endpoint=False)
    aorta = RoughVessel(np.concatenate([iliac, np.linspace([0, 0, 0], [0, 0, 0.13], 60)]), np.full(100, 0.008), 0)
    other = _vessel([0, 0, 0], [-0.06, 0, -0.07], 0.005, 1)
    other.start = float(np.hypot(0.06, 0.07))
    aorta.children.append(other)
    for height, number in ((0.03, 2), (0.05, 3), (0.07, 4)):
        child = _vessel([0, 0, height], [0, 0.09, height - 0.02], 0.003, number)
        child.start = other.start + height
        aorta.children.append(child)
    for turn in (np.eye(3), TURN):
        rotation, _ = world_rotation(turned(aorta, turn, np.zeros(3)))
        assert rotation[2] @ turn @ [0, 0, 1] > 0.92


def test_names_follow_the_arch_and_the_users():
    aorta = rough_vessels(sampled_arch(0), np.eye(3))["aorta"]
    rotation, kept = world_rotation(aorta)
    assert kept is False or np.allclose(np.abs(rotation).max(axis=1), 1)
    assert rotation[2] @ [0, 0, 1] > 0.95
    names, notes = name_vessels(aorta)
    assert [names[id(child)] for child in aorta.children] == ["lsa", "lcca", "bca"]
    assert notes == ()
    listed = final_names(aorta, names, ["a", "b", "c"])
    assert [listed[id(child)] for child in aorta.children] == ["c", "b", "a"]
    swapped = final_names(aorta, names, {"lcca": "lsa", "lsa": "lcca"})
    assert [swapped[id(child)] for child in aorta.children] == ["lcca", "lsa", "bca"]
    with pytest.raises(MeshRefusedError, match="names refer to rca, which was not found"):
        final_names(aorta, names, {"rca": "bca"})
    with pytest.raises(MeshRefusedError, match="names must differ"):
        final_names(aorta, names, {"lcca": "lsa"})
    with pytest.raises(MeshRefusedError, match="2 names were given for the 3 branches of the aorta"):
        final_names(aorta, names, ["a", "b"])


def test_targets_move_into_short_branches(tee: VesselTree):
    targets, notes = propose_targets(tee)
    assert targets["bca"].arc == pytest.approx(tee["bca"].length - 5e-3)
    assert "target bca lies 27 mm up its branch instead of 30" in notes[0]
    stub = Branch("bca", tee["bca"].points[:16], tee["bca"].radius[:16], "aorta", 0.04)
    targets, notes = propose_targets(VesselTree((tee.root, stub)))
    assert targets == {}
    assert "no target in bca" in notes[0]


@pytest.mark.parametrize("seed", [0, 4])
def test_vessels_from_the_groin_to_the_head_have_names(seed: int) -> None:
    tree = build_random_tree(RandomTree(seed))
    made = rough_vessels(tree, np.eye(3))
    names, _ = name_vessels(made["aorta"], sides_known=True)
    number = {index: branch.name for index, branch in enumerate(tree)}
    ends = {vessel.end: vessel for vessel in made["aorta"].every if vessel.end}
    assert {number[end]: names[id(vessel)] for end, vessel in ends.items()} == {
        number[end]: number[end] for end in ends
    }
    assert {"lcca", "rcca"} <= {names[id(vessel)] for vessel in made["aorta"].every if vessel.end is None}
    for vessel in made["aorta"].every:
        if names[id(vessel)].startswith("internal"):
            assert vessel.length == pytest.approx(tree[names[id(vessel)]].length, abs=0.012)


def test_an_arch_that_points_to_the_feet_or_lies_in_front_is_a_doubt() -> None:
    feet, front = "its arch points to the feet", "its descending aorta lies in front"
    for name in NAMED:
        aorta = build_arch(NAMED[name]).root.points
        assert pose_doubts(aorta) == ()
        for signs, doubts in (((1, 1, -1), [feet]), ((1, -1, 1), [front]), ((1, -1, -1), [feet, front])):
            (note,) = pose_doubts(aorta * signs)
            assert all(doubt in note for doubt in doubts)
        assert pose_doubts(aorta[: len(aorta) // 3]) == ()  # a stretch without the arch
