"""Places in a vessel tree: branch, depth behind the ostium, and ways between places."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cathsim.anatomy import Phantom
from cathsim.anatomy.branch_depth import BranchDepths
from cathsim.anatomy.vessel_tree import Branch, VesselTree


def straight(name: str, start: tuple, direction: tuple, length: float, radius: float, **of_branch: object) -> Branch:
    arc = np.arange(0.0, length + 1e-9, 1e-3)
    points = np.array(start) + arc[:, None] * np.array(direction)
    return Branch(name, points, np.full(len(arc), radius), **of_branch)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def depths() -> BranchDepths:
    """An aorta along z, an arm along x, and at 50 mm of it a side branch along y; lumens 20, 8 and 4 mm wide."""
    aorta = straight("aorta", (0, 0, 0), (0, 0, 1), 0.2, 0.010)
    arm = straight("arm", (0, 0, 0.1), (1, 0, 0), 0.1, 0.004, parent="aorta", parent_arc=0.1)
    side = straight("side", (0.05, 0, 0.1), (0, 1, 0), 0.04, 0.002, parent="arm", parent_arc=0.05)
    return BranchDepths(VesselTree((aorta, arm, side)))


@pytest.mark.parametrize(
    ("point", "branch", "depth"),
    [
        ((0.0, 0.0, 0.05), "aorta", 0.0),
        ((0.0095, 0.0, 0.1), "aorta", 0.0),  # on the arm's centreline, before its ostium
        ((0.0105, 0.0, 0.1), "arm", 0.0005),
        ((0.0305, 0.003, 0.1), "arm", 0.0205),  # beside the centreline, between two of its points
        ((0.0, -0.009, 0.13), "aorta", 0.0),
        ((0.05, 0.003, 0.1), "arm", 0.04),  # on the side branch's centreline, before its ostium
        ((0.05, 0.0241, 0.1), "side", 0.0201),
    ],
)
def test_a_point_has_a_branch_and_a_depth(
    depths: BranchDepths, point: tuple[float, float, float], branch: str, depth: float
) -> None:
    place = depths.place(point)
    assert place.branch == branch
    assert place.depth == pytest.approx(depth, abs=2e-4)


def test_ways_lead_along_the_branch_and_those_that_leave_it_further_on(depths: BranchDepths) -> None:
    near, far = depths.place((0.045, 0.0, 0.1)), depths.place((0.055, 0.0, 0.1))
    aside = depths.place((0.05, 0.006, 0.1))
    assert depths.way(far, near) == pytest.approx(0.010, abs=1e-6)
    assert depths.way(aside, near) == pytest.approx(0.005 + 0.006, abs=1e-6)
    assert depths.way(aside, far) == math.inf  # the side branch leaves before the goal
    assert depths.way(near, aside) == math.inf
    assert depths.way(depths.place((0.0, 0.0, 0.1)), near) == math.inf


def test_where_a_trunk_forks_is_the_trunk_and_its_daughters_leave_it_further_on(type_1: Phantom) -> None:
    trunk, daughter = type_1.tree["bca"], type_1.tree["rcca"]
    fork = type_1.depths.place(trunk.points[-1])
    assert (fork.branch, fork.arc) == ("bca", pytest.approx(trunk.length, abs=1e-6))
    tip = type_1.depths.place(daughter.point_at(0.004))
    assert tip.branch == "rcca"
    assert type_1.depths.way(tip, fork) == pytest.approx(0.004, abs=1e-4)


def test_targets_of_an_arch_have_the_depth_that_they_are_placed_at(type_1: Phantom) -> None:
    for name, depth in {"bca": 0.030, "lcca": 0.040, "lsa": 0.040, "rcca": 0.020, "rsa": 0.020}.items():
        place = type_1.depths.place(type_1.targets[name].position)
        assert (place.branch, place.depth) == (name, pytest.approx(depth, abs=1e-4))
