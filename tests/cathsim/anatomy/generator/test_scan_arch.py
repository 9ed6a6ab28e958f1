"""Arches as scans show them: seeds, sizes, cuts, targets, vessels that keep apart."""

import numpy as np
import pytest

from cathsim.anatomy.generator.recipe import build_grid, recipe_content, recipe_of
from cathsim.anatomy.generator.scan_arch import LEAST_WALL, STEEP, TRUNK, ScanArch, build_scan_arch, separation
from cathsim.anatomy.phantom import locate_targets, target_share

SEEDS = range(14)


@pytest.fixture(scope="module")
def trees():
    return [build_scan_arch(ScanArch(seed)) for seed in SEEDS]


def test_vessels_keep_apart_and_wide_enough(trees) -> None:
    for tree in trees:
        assert separation(tree) >= LEAST_WALL
        assert min(branch.radius.min() for branch in tree) >= 2.2e-3 - 1e-9
        assert {"aorta", "bca", "rsa", "rcca", "lcca", "lsa"} <= set(tree.names)


@pytest.mark.parametrize("shape", [STEEP, TRUNK])
def test_arches_of_rare_shapes_are_vessels_too(shape) -> None:
    rare = [build_scan_arch(ScanArch(seed, shape)) for seed in SEEDS]
    test_vessels_keep_apart_and_wide_enough(rare)
    for tree in rare:
        assert set(locate_targets(tree, target_share(tree))) == {"bca", "lcca", "lsa", "rcca", "rsa"}
    assert not np.array_equal(rare[0].root.points, build_scan_arch(ScanArch(0)).root.points)


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
