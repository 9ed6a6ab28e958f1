"""Arches of the arch variety: courses, order of the branches, sizes beside published arches, seeds, messages."""

import numpy as np
import pytest

from cathsim.anatomy.generator.scan_arch import separation
from cathsim.anatomy.generator.variety_arch import (
    ARCH_TYPES,
    COURSES,
    LEAST_WALL,
    Knot,
    VarietyArch,
    build_variety_arch,
    draw_course,
)
from cathsim.anatomy.lumen import build_lumen

SEEDS = range(6)
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
def trees():
    return {kind: [build_variety_arch(VarietyArch(kind, seed)) for seed in SEEDS] for kind in ARCH_TYPES}


@pytest.mark.parametrize("kind", ARCH_TYPES)
def test_branches_leave_the_aorta_in_the_order_of_the_type(trees, kind):
    seen = set()
    for tree in trees[kind]:
        leaving = sorted((b for b in tree if b.parent == "aorta"), key=lambda b: -b.parent_arc)
        seen.add(tuple(branch.name for branch in leaving))
    assert seen == set(ORDER[kind])


def test_sizes_are_those_of_published_arches(trees):
    # aortas of the published generator at these settings: 276 and 282 mm long, radii 6.9 to 12.3 mm
    aortas = [tree.root for kind in ARCH_TYPES for tree in trees[kind]]
    assert np.mean([aorta.length for aorta in aortas]) == pytest.approx(0.279, abs=0.006)
    assert np.mean([aorta.radius.min() for aorta in aortas]) == pytest.approx(7.0e-3, abs=4e-4)
    assert np.mean([aorta.radius.max() for aorta in aortas]) == pytest.approx(12.3e-3, abs=4e-4)
    heights = [branch.points[-1, 2] - tree.root.points[0, 2] for tree in trees["I"] for branch in (tree["lcca"],)]
    assert heights == pytest.approx([0.230] * len(heights), abs=1e-3)


def test_vessels_keep_apart_and_make_a_lumen(trees):
    for kind in ARCH_TYPES:
        assert all(separation(tree) >= LEAST_WALL for tree in trees[kind])
        grid = build_lumen(trees[kind][0], resolution=1.5e-3, fillet_radius=2.5e-3)
        for branch in trees[kind][0]:
            assert (grid.sample(branch.points[5:-5]) > 1e-3).all()


def test_a_type_that_there_is_not_is_refused():
    with pytest.raises(ValueError, match="arch_type must be one of I, II, IV, V, VI, VII, got 'III'"):
        VarietyArch("III", 1)
    with pytest.raises(ValueError, match="seed"):
        VarietyArch("I", -1)


@pytest.mark.parametrize("name", [name for name, course in COURSES.items() if course[0].heading is not None])
def test_means_of_many_draws_are_those_of_the_waypoints(name):
    rng = np.random.default_rng(1)
    parent = Knot(np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.01, 0.0)
    start = np.array([0.01, -0.05, 0.14])
    ends = np.array([draw_course(name, start, rng, parent=parent)[-1].place for _ in range(300)])
    last = COURSES[name][-1]
    offset = np.where([axis in last.fixed for axis in "xyz"], 0.0, start)
    spread = 1e-3 * np.array(last.place_spread_mm)
    assert ends.mean(axis=0) == pytest.approx(offset + 1e-3 * np.array(last.place_mm), abs=4 * spread.max() / 300**0.5)
    assert ends.std(axis=0) == pytest.approx(spread, rel=0.2, abs=1e-9)
