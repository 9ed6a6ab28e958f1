"""Arches as scans show them: seeds, sizes, cuts, targets, vessels that keep apart."""

import numpy as np
import pytest

from cathsim.anatomy.generator.random_arch import separation
from cathsim.anatomy.generator.recipe import build_grid
from cathsim.anatomy.generator.scan_arch import LEAST_WALL, ScanArch, build_scan_arch
from cathsim.anatomy.phantom import locate_targets, target_share

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
