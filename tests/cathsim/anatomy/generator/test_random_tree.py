"""Random trees: their vessels, calibres, courses, aberrant arches, repetition and lumen."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim import load_phantom
from cathsim.anatomy import VesselTree
from cathsim.anatomy.generator.random_tree import LEAST_WALL, RandomTree, build_random_tree
from cathsim.anatomy.generator.scan_arch import separation
from cathsim.anatomy.geodesic import graph_distance
from cathsim.anatomy.library import phantom_described, phantom_description

SEEDS = range(24)
NECK = [
    f"{name}_{side}" for name in ("internal_carotid", "external_carotid", "vertebral") for side in ("left", "right")
]


@pytest.fixture(scope="module")
def trees() -> list[VesselTree]:
    return [build_random_tree(RandomTree(seed)) for seed in SEEDS]


def test_a_tree_leads_from_an_iliac_artery_to_the_head(trees: list[VesselTree]) -> None:
    sides = set()
    for tree in trees:
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
        for branch in tree:
            turn = np.linalg.norm(np.gradient(branch.tangents, branch.arc, axis=0), axis=1) * branch.radius
            assert turn[5:-5].max() < 1  # no lumen folds into itself
    assert sides == {"iliac_left", "iliac_right"}


def test_sides_are_left_and_right(trees: list[VesselTree]) -> None:
    for tree in trees:
        ends = {name: tree[name].points[-1, 0] for name in NECK}
        for vessel in ("internal_carotid", "external_carotid", "vertebral"):
            assert ends[f"{vessel}_left"] > ends[f"{vessel}_right"] + 0.01


def test_calibres_are_the_published_ones(trees: list[VesselTree]) -> None:
    def diameters(*names: str) -> np.ndarray:
        return np.array([2e3 * tree[name].radius_at(0.06) for tree in trees for name in names])

    assert diameters("lcca", "rcca").mean() == pytest.approx(6.3, abs=0.4)  # mm, women's and men's mean
    assert diameters("internal_carotid_left", "internal_carotid_right").mean() == pytest.approx(4.7, abs=0.4)
    assert diameters("vertebral_left", "vertebral_right").min() > 2.4
    assert diameters("vertebral_left", "vertebral_right").max() < 4.5


def test_arches_are_usual_and_aberrant(trees: list[VesselTree]) -> None:
    assert {tree["lcca"].parent for tree in trees} >= {"aorta", "bca"}
    aberrant = [tree for tree in trees if tree["rsa"].parent == "aorta"]
    assert 1 <= len(aberrant) < len(trees) / 2
    assert all(separation(tree) >= LEAST_WALL for tree in trees)
    from_arch = next(
        tree for tree in map(build_random_tree, map(RandomTree, range(100))) if tree["vertebral_left"].parent == "aorta"
    )
    arcs = [from_arch[name].parent_arc for name in ("lsa", "vertebral_left", "lcca")]
    assert arcs == sorted(arcs)


def test_a_seed_is_one_tree_with_targets_along_its_vessels() -> None:
    phantom = load_phantom("random_tree", seed=4)
    assert phantom is load_phantom("random_tree_4")
    assert np.array_equal(phantom.tree["rcca"].points, build_random_tree(RandomTree(4))["rcca"].points)
    assert phantom.hash == phantom_described(phantom_description(phantom)).hash
    for branch in phantom.tree:
        assert (phantom.grid.sample(branch.points[5:-5]) > 0).all(), branch.name
    place = phantom.depths.place(phantom.target("internal_carotid_left@100").position)
    assert (place.branch, round(place.depth, 3)) == ("internal_carotid_left", 0.1)
    assert {"iliac_right", "vertebral_left", "internal_carotid_left", "internal_carotid_left_end"} <= set(
        phantom.targets
    )
