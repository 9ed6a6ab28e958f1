"""Generated vessels: arches by their measures, as scans show them and of every type, and whole trees."""

import dataclasses
import json
from itertools import chain

import numpy as np
import pytest

from cathsim import load_phantom
from cathsim.anatomy import Aneurysm, ArchParameters, VesselTree
from cathsim.anatomy.generator import random_tree, scan_arch, variety_arch
from cathsim.anatomy.generator.aortic_arch import build_arch
from cathsim.anatomy.generator.arch_parameters import draw_parameters
from cathsim.anatomy.generator.random_tree import RandomTree, build_random_tree
from cathsim.anatomy.generator.recipe import RANDOM, build_grid, draw_recipe, recipe_content, recipe_of
from cathsim.anatomy.generator.scan_arch import (
    MINIMUM_SEPARATION,
    STEEP,
    TRUNK,
    ScanArch,
    build_scan_arch,
    sample_parameters,
    separation,
)
from cathsim.anatomy.generator.variety_arch import (
    ARCH_TYPES,
    PATHS,
    Knot,
    VarietyArch,
    build_variety_arch,
    draw_path,
)
from cathsim.anatomy.geodesic import graph_distance
from cathsim.anatomy.library import NAMED, phantom_from_spec, phantom_to_spec
from cathsim.anatomy.lumen import build_lumen
from cathsim.anatomy.phantom import locate_targets, target_share

TYPES = {"type_1": "I", "type_2": "II", "type_3": "III", "type_1_aneurysm": "I", "low_tortuosity": "I", "bovine": "I"}


@pytest.fixture(scope="module")
def trees() -> dict[str, VesselTree]:
    return {name: build_arch(parameters) for name, parameters in NAMED.items()}


@pytest.mark.parametrize("name", NAMED)
def test_arch_type_by_its_clinical_definition(trees, name):
    """The top of the aortic wall over the BCA's ostium: below one diameter of the LCCA I, up to two II, above III."""
    tree = trees[name]
    steepness = np.clip(tree.root.tangents[:, 2], -1, 1)
    top = np.max(tree.root.points[:, 2] + tree.root.radius * np.sqrt(1 - steepness**2))
    drop, ostium = top - tree.ostium("bca")[2], tree.ostium_arc("lcca")
    # The type must not hang on whether the carotid is measured at its origin or beyond its flare.
    at_origin, beyond = (drop / (2 * tree["lcca"].radius_at(ostium + arc)) for arc in (0.0, 0.025))
    for ratio in (at_origin, beyond):
        assert ("I", "II", "III")[np.searchsorted([1.0, 2.0], ratio, side="right")] == TYPES[name]
    assert at_origin == pytest.approx(NAMED[name].apex_ratio, abs=0.2)


def test_the_aorta_tapers_from_root_to_descending_end(trees):
    aorta = trees["type_1"].root
    assert 2 * aorta.radius[-1] == pytest.approx(0.0318, abs=1e-5)
    assert 2 * aorta.radius[0] == pytest.approx(0.0239, abs=1e-5)
    assert np.all(np.diff(aorta.radius) >= -1e-9)


def test_branches_leave_in_order_and_run_up(trees):
    for tree in trees.values():
        bca, lcca, lsa = (tree.ostium(name) for name in ("bca", "lcca", "lsa"))
        assert bca[0] < lcca[0] < lsa[0], "from the patient's right to the left"
        for name in ("bca", "lcca", "rcca", "lsa"):
            branch = tree[name]
            assert branch.points[-1, 2] - branch.points[0, 2] > 0.03
        trunk = tree["bca"].length - tree.ostium_arc("bca")
        assert 0.034 <= trunk <= 0.046
        assert tree["lcca"].length - tree.ostium_arc("lcca") >= 0.080
        assert trunk + tree["rcca"].length >= 0.080
        assert tree["rsa"].points[-1, 0] < tree["bca"].points[-1, 0] - 0.02, "to the patient's right"
        assert tree["lsa"].points[-1, 0] > tree["lsa"].points[0, 0] + 0.02, "to the patient's left"


def test_fusiform_and_saccular_aneurysms_widen_the_lumen(trees):
    plain = trees["type_1"].root
    fusiform = build_arch(dataclasses.replace(NAMED["type_1"], aneurysm=Aneurysm("fusiform", bulge=0.009)))
    assert np.max(fusiform.root.radius - plain.radius) == pytest.approx(0.009, abs=2e-4)
    saccular = build_arch(dataclasses.replace(NAMED["type_1"], aneurysm=Aneurysm("saccular", bulge=0.009)))
    assert saccular["sac"].parent == "aorta"
    dome = saccular["sac"].point_at(1.0)
    reach = np.linalg.norm(dome - saccular["sac"].points[0]) + saccular["sac"].radius[-1]
    wall = saccular.root.radius_at(saccular["sac"].parent_arc)
    assert reach - wall == pytest.approx(0.009, abs=1e-4)


def test_measures_that_do_not_join_are_refused_with_advice():
    with pytest.raises(ValueError, match="raise descending_height or ascending_height"):
        build_arch(ArchParameters(arch_width=0.085, ascending_height=0.055))
    with pytest.raises(ValueError, match="bends too tightly"):
        build_arch(ArchParameters(arch_width=0.055, root_diameter=0.042, tortuosity=0.008, ascending_height=0.11))
    with pytest.raises(ValueError, match="too near the aortic root"):
        build_arch(ArchParameters(apex_ratio=4.0, lcca_diameter=0.0135, ascending_height=0.062, arch_width=0.055))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"root_diameter": 31.8}, r"root_diameter must lie in \[0.024, 0.042\] \(m or rad\), got 31.8"),
        ({"trunk_length": "long"}, "trunk_length must be a number, got 'long'"),
        ({"root_diameter": 0.025, "descending_diameter": 0.030}, "must not exceed root_diameter"),
        ({"kind": "round"}, "kind must be one of fusiform, saccular, got 'round'"),
        ({"length": 0.03, "bulge": 0.012}, "too steep"),
    ],
)
def test_impossible_measures_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        (Aneurysm if arguments.keys() & {"kind", "bulge"} else ArchParameters)(**arguments)


def test_draws_follow_the_published_spread():
    rng = np.random.default_rng(0)
    draws = [draw_parameters(rng) for _ in range(600)]
    roots = np.array([d.root_diameter for d in draws])
    assert roots.mean() == pytest.approx(0.0318, abs=6e-4)
    assert roots.std() == pytest.approx(0.003, abs=6e-4)
    assert 0.08 < np.mean([d.bovine for d in draws]) < 0.22
    kinds = {d.aneurysm.kind for d in draws if d.aneurysm}
    assert kinds == {"fusiform", "saccular"}


def test_sampled_arches_keep_their_vessels_apart():
    for seed in range(6):
        tree = build_arch(sample_parameters(np.random.default_rng(seed)))
        assert separation(tree) >= MINIMUM_SEPARATION


def test_a_recipe_comes_back_from_json():
    for name in RANDOM:
        recipe = draw_recipe(name, 5)
        assert recipe_of(json.loads(json.dumps(recipe_content(recipe)))) == recipe


SCAN_SEEDS = range(8)


@pytest.mark.parametrize("shape", [(), (STEEP,), (TRUNK,)])
def test_vessels_keep_apart_and_wide_enough(shape) -> None:
    trees = [build_scan_arch(ScanArch(seed, *shape)) for seed in SCAN_SEEDS]
    for tree in trees:
        assert separation(tree) >= scan_arch.LEAST_WALL
        assert min(branch.radius.min() for branch in tree) >= 2.2e-3 - 1e-9
        assert {"aorta", "bca", "rsa", "rcca", "lcca", "lsa"} <= set(tree.names)
        if shape:
            assert set(locate_targets(tree, target_share(tree))) == {"bca", "lcca", "lsa", "rcca", "rsa"}
    if shape:
        assert not np.array_equal(trees[0].root.points, build_scan_arch(ScanArch(0)).root.points)


def test_an_arch_of_the_common_shape_is_described_as_before_there_were_others() -> None:
    content = recipe_content(ScanArch(7))
    assert content["scan"] == {"seed": 7}
    assert recipe_of(content) == ScanArch(7)


def test_a_seed_is_one_lumen_at_any_resolution() -> None:
    arch = ScanArch(3)
    tree, again = build_scan_arch(arch), build_scan_arch(arch)
    assert all(np.array_equal(one.points, other.points) for one, other in zip(tree, again, strict=True))
    fine, coarse = (build_grid(arch, tree, resolution) for resolution in (1e-3, 1.5e-3))
    aside = np.cross(tree.root.tangents, [0.0, 1.0, 0.0])
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    points = (tree.root.points + 0.9 * tree.root.radius[:, None] * aside)[8:-8]
    near = np.abs(fine.sample(points)) < 1.5e-3
    assert near.sum() > 30
    assert coarse.sample(points[near]) == pytest.approx(fine.sample(points[near]), abs=2.5e-4)


VARIETY_SEEDS = range(6)
# branches of the aorta from its root on, as the published descriptions of the types have them
ORDER = {
    "I": (("bca", "lcca", "lsa"),),
    "II": (("bca", "lsa"),),
    "IV": (("rsa", "carotid_trunk", "lsa"),),
    "V": (("carotid_trunk", "lsa", "rsa"), ("rcca", "lcca", "lsa", "rsa")),
    "VI": (("carotid_trunk", "subclavian_trunk"),),
    "VII": (("rsa", "rcca", "lcca", "lsa"),),
}


@pytest.fixture(scope="module")
def variety_trees():
    return {kind: [build_variety_arch(VarietyArch(kind, seed)) for seed in VARIETY_SEEDS] for kind in ARCH_TYPES}


def test_branches_leave_the_aorta_in_the_order_of_the_type(variety_trees):
    for kind in ARCH_TYPES:
        leaving = [
            sorted((b for b in tree if b.parent == "aorta"), key=lambda b: -b.parent_arc)
            for tree in variety_trees[kind]
        ]
        assert {tuple(branch.name for branch in one) for one in leaving} == set(ORDER[kind])


def test_sizes_are_those_of_published_arches(variety_trees):
    # aortas of the published generator at these settings: 276 and 282 mm long, radii 6.9 to 12.3 mm
    aortas = [tree.root for kind in ARCH_TYPES for tree in variety_trees[kind]]
    assert np.mean([aorta.length for aorta in aortas]) == pytest.approx(0.279, abs=0.006)
    assert np.mean([aorta.radius.min() for aorta in aortas]) == pytest.approx(7.0e-3, abs=4e-4)
    assert np.mean([aorta.radius.max() for aorta in aortas]) == pytest.approx(12.3e-3, abs=4e-4)
    heights = [tree["lcca"].points[-1, 2] - tree.root.points[0, 2] for tree in variety_trees["I"]]
    assert heights == pytest.approx([0.230] * len(heights), abs=1e-3)


def test_vessels_keep_apart_and_make_a_lumen(variety_trees):
    for kind in ARCH_TYPES:
        assert all(separation(tree) >= variety_arch.LEAST_WALL for tree in variety_trees[kind])
        grid = build_lumen(variety_trees[kind][0], resolution=1.5e-3, fillet_radius=2.5e-3)
        for branch in variety_trees[kind][0]:
            assert (grid.sample(branch.points[5:-5]) > 1e-3).all()


def test_a_type_that_there_is_not_is_refused():
    with pytest.raises(ValueError, match="arch_type must be one of I, II, IV, V, VI, VII, got 'III'"):
        VarietyArch("III", 1)
    with pytest.raises(ValueError, match="seed"):
        VarietyArch("I", -1)


@pytest.mark.parametrize("name", [name for name, path in PATHS.items() if path[0].heading is not None])
def test_means_of_many_draws_are_those_of_the_waypoints(name):
    rng = np.random.default_rng(1)
    parent = Knot(np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.01, 0.0)
    start = np.array([0.01, -0.05, 0.14])
    ends = np.array([draw_path(name, start, rng, parent=parent)[-1].place for _ in range(300)])
    last = PATHS[name][-1]
    offset = np.where([axis in last.fixed for axis in "xyz"], 0.0, start)
    spread = 1e-3 * np.array(last.place_spread_mm)
    assert ends.mean(axis=0) == pytest.approx(offset + 1e-3 * np.array(last.place_mm), abs=4 * spread.max() / 300**0.5)
    assert ends.std(axis=0) == pytest.approx(spread, rel=0.2, abs=1e-9)


RANDOM_SEEDS = range(14)
NECK = [
    f"{name}_{side}" for name in ("internal_carotid", "external_carotid", "vertebral") for side in ("left", "right")
]


@pytest.fixture(scope="module")
def random_trees() -> list[VesselTree]:
    return [build_random_tree(RandomTree(seed)) for seed in RANDOM_SEEDS]


def test_a_tree_leads_from_an_iliac_artery_to_the_head(random_trees: list[VesselTree]) -> None:
    sides = set()
    for tree in random_trees:
        assert {"aorta", "lcca", "rcca", "lsa", "rsa", *NECK} <= set(tree.names)
        (other,) = (name for name in tree.names if name.startswith("iliac_"))
        sides.add(other)
        assert (tree[other].points[-1, 0] > tree.root.points[0, 0]) == (other == "iliac_left")
        for name in NECK:
            end, left = tree[name].points[-1], name.endswith("left")
            assert end[2] > tree.root.points[:, 2].max() + 0.12
            if "carotid" in name:
                assert tree[name].parent == ("lcca" if left else "rcca")
            way = graph_distance(tree, "aorta", 0.0, name, tree[name].length)
            assert 0.55 < way < 0.95
        for vessel in ("internal_carotid", "external_carotid", "vertebral"):
            assert tree[f"{vessel}_left"].points[-1, 0] > tree[f"{vessel}_right"].points[-1, 0] + 0.01
        for branch in tree:
            turn = np.linalg.norm(np.gradient(branch.tangents, branch.arc, axis=0), axis=1) * branch.radius
            assert turn[5:-5].max() < 1  # no lumen folds into itself
    assert sides == {"iliac_left", "iliac_right"}


def test_calibres_are_the_published_ones(random_trees: list[VesselTree]) -> None:
    def diameters(*names: str) -> np.ndarray:
        return np.array([2e3 * tree[name].radius_at(0.06) for tree in random_trees for name in names])

    assert diameters("lcca", "rcca").mean() == pytest.approx(6.3, abs=0.4)  # mm, women's and men's mean
    assert diameters("internal_carotid_left", "internal_carotid_right").mean() == pytest.approx(4.7, abs=0.4)
    assert diameters("vertebral_left", "vertebral_right").min() > 2.4
    assert diameters("vertebral_left", "vertebral_right").max() < 4.5


def test_no_vessel_is_narrower_than_the_grid_resolves() -> None:
    assert min(branch.radius.min() for branch in build_random_tree(RandomTree(11))) == random_tree.NARROWEST


def test_arches_are_usual_and_aberrant(random_trees: list[VesselTree]) -> None:
    assert {tree["lcca"].parent for tree in random_trees} >= {"aorta", "bca"}
    aberrant = [tree for tree in random_trees if tree["rsa"].parent == "aorta"]
    assert 1 <= len(aberrant) < len(random_trees) / 2
    assert all(separation(tree) >= random_tree.LEAST_WALL for tree in random_trees)
    more = (build_random_tree(RandomTree(seed)) for seed in range(len(random_trees), 100))
    from_arch = next(tree for tree in chain(random_trees, more) if tree["vertebral_left"].parent == "aorta")
    arcs = [from_arch[name].parent_arc for name in ("lsa", "vertebral_left", "lcca")]
    assert arcs == sorted(arcs)


def test_a_seed_is_one_tree_with_targets_along_its_vessels() -> None:
    phantom = load_phantom("random_tree", seed=4)
    assert phantom is load_phantom("random_tree_4")
    assert np.array_equal(phantom.tree["rcca"].points, build_random_tree(RandomTree(4))["rcca"].points)
    assert phantom.hash == phantom_from_spec(phantom_to_spec(phantom)).hash
    for branch in phantom.tree:
        assert (phantom.grid.sample(branch.points[5:-5]) > 0).all(), branch.name
    place = phantom.depths.place(phantom.target("internal_carotid_left@100").position)
    assert (place.branch, round(place.depth, 3)) == ("internal_carotid_left", 0.1)
    assert {"iliac_right", "vertebral_left", "internal_carotid_left", "internal_carotid_left_end"} <= set(
        phantom.targets
    )
