"""Vessel trees: invariants, arc length, ostia, nearest points."""

import numpy as np
import pytest

from cathsim.anatomy import Branch, VesselTree
from cathsim.anatomy.vessel_tree import nearest_on_branch

LINE = np.stack([np.zeros(5), np.zeros(5), np.linspace(0, 0.04, 5)], axis=1)


def test_arc_point_tangent_and_radius_of_a_straight_branch():
    branch = Branch("aorta", LINE, np.linspace(0.01, 0.006, 5))
    assert branch.length == pytest.approx(0.04)
    assert branch.point_at(0.025) == pytest.approx([0, 0, 0.025])
    assert branch.point_at([[-1.0, 9.0]]).shape == (1, 2, 3)
    assert branch.point_at(9.0) == pytest.approx([0, 0, 0.04])
    assert branch.tangent_at([0.0, 0.033]) == pytest.approx(np.array([[0, 0, 1.0]] * 2))
    assert branch.radius_at(0.02) == pytest.approx(0.008)


def test_quarter_circle_has_its_known_length():
    angle = np.linspace(0, np.pi / 2, 400)
    branch = Branch("aorta", 0.03 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1), np.full(400, 0.01))
    assert branch.length == pytest.approx(0.03 * np.pi / 2, rel=1e-5)
    assert branch.tangent_at(branch.length / 2) == pytest.approx([-np.sqrt(0.5), np.sqrt(0.5), 0], abs=1e-3)


@pytest.mark.parametrize(
    ("points", "radius", "message"),
    [
        (LINE[:, :2], np.full(5, 0.01), r"shape \(n >= 2, 3\), got \(5, 2\)"),
        (LINE, np.full(4, 0.01), r"shape \(5,\) like its points, got \(4,\)"),
        (LINE * np.nan, np.full(5, 0.01), "must be finite"),
        (LINE, np.array([0.01, 0.01, 0.0, 0.01, 0.01]), "radius must be positive"),
        (LINE[[0, 1, 1, 2, 3]], np.full(5, 0.01), "consecutive points must differ"),
    ],
)
def test_a_branch_refuses_what_is_no_vessel(points, radius, message):
    with pytest.raises(ValueError, match=message):
        Branch("aorta", points, radius)


def test_a_tree_refuses_broken_joints():
    root = Branch("aorta", LINE, np.full(5, 0.01))
    aside = Branch("bca", LINE + np.array([0.005, 0, 0]), np.full(5, 0.004), "aorta", 0.0)
    with pytest.raises(ValueError, match=r"begins 5\.00 mm away"):
        VesselTree((root, aside))
    with pytest.raises(ValueError, match="appears twice"):
        VesselTree((root, Branch("aorta", LINE, root.radius, "aorta", 0.0)))
    with pytest.raises(ValueError, match="parent 'trunk' must come before"):
        VesselTree((root, Branch("bca", LINE, root.radius, "trunk", 0.0)))
    with pytest.raises(ValueError, match="parent_arc must lie in"):
        VesselTree((root, Branch("bca", LINE, root.radius, "aorta", 0.9)))
    with pytest.raises(ValueError, match="the first branch alone has no parent"):
        VesselTree((root, Branch("bca", LINE, root.radius)))
    with pytest.raises(KeyError, match="no branch 'lsa'; this tree has aorta"):
        VesselTree((root,))["lsa"]


def test_the_ostium_lies_on_the_parents_wall(tee):
    assert tee.ostium_arc("bca") == pytest.approx(0.008, abs=1.1e-4)
    assert tee.ostium("bca") == pytest.approx([0.008, 0, 0], abs=1.1e-4)
    assert tee.ostium_arc("aorta") == 0.0
    assert tee.ancestry("bca") == ("aorta", "bca")


def test_a_branch_that_stays_inside_has_no_ostium(tee):
    short = Branch("lcca", tee["bca"].points[:6], np.full(6, 0.004), "aorta", 0.04)
    with pytest.raises(ValueError, match="never leaves the lumen"):
        VesselTree((tee.root, short)).ostium_arc("lcca")


def test_nearest_point_is_that_of_a_dense_search():
    rng = np.random.default_rng(3)
    t = np.linspace(0, 4, 90)
    branch = Branch("aorta", 0.02 * np.stack([np.cos(t), np.sin(t), 0.3 * t], axis=1), np.full(90, 0.004))
    points = branch.points[rng.integers(0, 90, 200)] + rng.normal(0, 0.004, (200, 3))
    foot, arc, distance = nearest_on_branch(branch, points)
    dense = branch.point_at(np.linspace(0, branch.length, 20_000))
    expected = np.array([np.linalg.norm(dense - p, axis=1).min() for p in points])
    assert distance == pytest.approx(expected, abs=2e-6)
    assert branch.point_at(arc) == pytest.approx(foot, abs=1e-9)
