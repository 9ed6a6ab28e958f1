"""Arches as scans show them: seeds, sizes, cuts, targets, vessels that keep apart."""

import numpy as np
import pytest

from cathsim.anatomy.generator.recipe import build_grid, draw_recipe, recipe_content, recipe_of
from cathsim.anatomy.generator.scan_arch import LEAST_WALL, STEEP, TRUNK, ScanArch, build_scan_arch, separation
from cathsim.anatomy.phantom import locate_targets, target_share
from cathsim.anatomy.vessel_tree import set_back

SEEDS = range(14)


@pytest.fixture(scope="module")
def trees():
    return [build_scan_arch(ScanArch(seed)) for seed in SEEDS]


def test_sizes_and_lengths_vary_more_than_those_of_random_arches(trees) -> None:
    roots = [2e3 * tree.root.radius[-1] for tree in trees]
    assert min(roots) < 22
    assert max(roots) > 30
    lengths = [tree.root.length for tree in trees]
    assert max(lengths) > 1.8 * min(lengths)


def test_vessels_keep_apart_and_wide_enough(trees) -> None:
    for tree in trees:
        assert separation(tree) >= LEAST_WALL
        assert min(branch.radius.min() for branch in tree) >= 2.2e-3 - 1e-9
        assert {"aorta", "bca", "rsa", "rcca", "lcca", "lsa"} <= set(tree.names)


def test_every_target_fits_into_its_branch(trees) -> None:
    for tree in trees:
        assert 0.2 < target_share(tree) <= 1
        assert set(locate_targets(tree, target_share(tree))) == {"bca", "lcca", "lsa", "rcca", "rsa"}


@pytest.mark.parametrize("shape", [STEEP, TRUNK])
def test_arches_of_rare_shapes_are_vessels_too(shape) -> None:
    rare = [build_scan_arch(ScanArch(seed, shape)) for seed in SEEDS]
    test_vessels_keep_apart_and_wide_enough(rare)
    test_every_target_fits_into_its_branch(rare)
    assert not np.array_equal(rare[0].root.points, build_scan_arch(ScanArch(0)).root.points)


def test_branches_of_elongated_aortas_leave_far_below_the_top(trees) -> None:
    rare = [build_scan_arch(ScanArch(seed, STEEP)) for seed in SEEDS]
    for name, least in (("bca", 10e-3), ("lcca", 8e-3), ("lsa", 4e-3)):
        lower, common = (np.median([set_back(tree, name) for tree in those]) for those in (rare, trees))
        assert lower > common + least


def test_a_left_carotid_turns_off_its_trunk() -> None:
    for seed in SEEDS:
        tree = build_scan_arch(ScanArch(seed, TRUNK))
        assert tree["lcca"].parent == "bca"
        begins = tree.ostium_arc("lcca")
        way = tree["lcca"].point_at(begins + 0.012) - tree["lcca"].point_at(begins)
        assert way[2] / np.linalg.norm(way) < np.cos(np.radians(40))


def test_a_name_and_a_seed_are_one_rare_arch() -> None:
    for name, shape in (("random_steep", STEEP), ("random_trunk", TRUNK)):
        recipe = draw_recipe(name, 7)
        assert recipe == ScanArch(7, shape) == recipe_of(recipe_content(recipe))


def test_an_arch_of_the_common_shape_is_described_as_before_there_were_others() -> None:
    content = recipe_content(ScanArch(7))
    assert content["scan"] == {"seed": 7}
    assert recipe_of(content) == ScanArch(7)


def test_a_shape_that_there_is_not() -> None:
    with pytest.raises(ValueError, match="common, steep, trunk, got 'flat'"):
        ScanArch(0, "flat")


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
