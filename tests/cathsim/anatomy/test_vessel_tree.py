"""Vessel trees: invariants, ostia, nearest points, places behind an ostium, extension, how far it is set back."""

import math

import numpy as np
import pytest

from cathsim.anatomy import Branch, VesselTree
from cathsim.anatomy.extension import DEPTH, extend_short_branches
from cathsim.anatomy.lumen import build_lumen
from cathsim.anatomy.phantom import END_CLEARANCE
from cathsim.anatomy.point_target import BranchDepths
from cathsim.anatomy.vessel_tree import nearest_on_branch, set_back

LINE = np.stack([np.zeros(5), np.zeros(5), np.linspace(0, 0.04, 5)], axis=1)


def test_arc_point_tangent_and_radius_of_a_straight_branch():
    branch = Branch("aorta", LINE, np.linspace(0.01, 0.006, 5))
    assert branch.length == pytest.approx(0.04)
    assert branch.point_at(0.025) == pytest.approx([0, 0, 0.025])
    assert branch.point_at([[-1.0, 9.0]]).shape == (1, 2, 3)
    assert branch.point_at(9.0) == pytest.approx([0, 0, 0.04])
    assert branch.tangent_at([0.0, 0.033]) == pytest.approx(np.array([[0, 0, 1.0]] * 2))
    assert branch.radius_at(0.02) == pytest.approx(0.008)


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
    for branch, message in (
        (Branch("bca", np.add(LINE, [0.005, 0, 0]), root.radius, "aorta", 0.0), r"begins 5\.00 mm away"),
        (Branch("aorta", LINE, root.radius, "aorta", 0.0), "appears twice"),
        (Branch("bca", LINE, root.radius, "trunk", 0.0), "parent 'trunk' must come before"),
        (Branch("bca", LINE, root.radius, "aorta", 0.9), "parent_arc must lie in"),
        (Branch("bca", LINE, root.radius), "the first branch alone has no parent"),
    ):
        with pytest.raises(ValueError, match=message):
            VesselTree((root, branch))
    with pytest.raises(KeyError, match="no branch 'lsa'; this tree has aorta"):
        VesselTree((root,))["lsa"]


def test_the_ostium_lies_on_the_parents_wall(tee):
    assert tee.ostium_arc("bca") == pytest.approx(0.008, abs=1.1e-4)
    assert tee.ostium("bca") == pytest.approx([0.008, 0, 0], abs=1.1e-4)
    assert tee.ostium_arc("aorta") == 0.0
    assert tee.ancestry("bca") == ("aorta", "bca")
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


def straight(name: str, start: tuple, end: tuple, count: int, radius: float, **of_branch: object) -> Branch:
    points = np.linspace(start, end, count)
    return Branch(name, points, np.full(count, radius), **of_branch)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def depths() -> BranchDepths:
    """An aorta along z, an arm along x, and at 50 mm of it a side branch along y; lumens 20, 8 and 4 mm wide."""
    aorta = straight("aorta", (0, 0, 0), (0, 0, 0.2), 201, 0.010)
    arm = straight("arm", (0, 0, 0.1), (0.1, 0, 0.1), 101, 0.004, parent="aorta", parent_arc=0.1)
    side = straight("side", (0.05, 0, 0.1), (0.05, 0.04, 0.1), 41, 0.002, parent="arm", parent_arc=0.05)
    return BranchDepths(VesselTree((aorta, arm, side)))


def test_a_point_has_a_branch_and_a_depth(depths: BranchDepths) -> None:
    for point, branch, depth in (
        ((0.0, 0.0, 0.05), "aorta", 0.0),
        ((0.0095, 0.0, 0.1), "aorta", 0.0),  # on the arm's centreline, before its ostium
        ((0.0105, 0.0, 0.1), "arm", 0.0005),
        ((0.0305, 0.003, 0.1), "arm", 0.0205),  # beside the centreline, between two of its points
        ((0.05, 0.003, 0.1), "arm", 0.04),  # on the side branch's centreline, before its ostium
        ((0.05, 0.0241, 0.1), "side", 0.0201),
    ):
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


AORTA, RADIUS, STUB = 0.010, 0.004, 0.012  # m


def drawn(*more: Branch) -> VesselTree:
    """A straight aorta along z with a stub along x, and other branches."""
    root = straight("aorta", (0, 0, 0), (0, 0, 0.08), 60, AORTA)
    stub = straight("stub", (0, 0, 0.04), (AORTA + STUB, 0, 0.04), 60, RADIUS, parent="aorta", parent_arc=0.04)
    return VesselTree((root, stub, *more))


def test_a_stub_goes_on_along_its_direction_with_its_radius() -> None:
    tree = drawn()
    grid = build_lumen(tree, resolution=1e-3, fillet_radius=1e-3)
    extended, longer, notes = extend_short_branches(tree, grid)
    stub = extended["stub"]
    assert len(notes) == 1
    assert notes[0].startswith("stub is cut 12 mm behind its ostium, and extended by 23 mm")
    assert stub.length - extended.ostium_arc("stub") == pytest.approx(DEPTH + END_CLEARANCE, abs=1e-3)
    assert stub.radius == pytest.approx(RADIUS, abs=1e-4)
    x = np.arange(AORTA + 5e-3, AORTA + 0.034, 5e-4)
    for angle in np.linspace(0, 2 * np.pi, 9):
        at = [np.array([x, r * np.cos(angle) + 0 * x, 0.04 + r * np.sin(angle) + 0 * x]).T for r in (0.0032, 0.0048)]
        assert (longer.sample(at[0]) > 2e-4).all()  # no step where the tube begins
        assert (longer.sample(at[1]) < -2e-4).all()
    assert longer.sample([AORTA + 0.0365, 0, 0.04]) < 0  # closed by a flat end
    before, places = grid.blocks.where(lambda values: values > -0.005)
    near_aorta = grid.coordinates(before)[:, 0] < AORTA + 2e-3
    assert longer.sample(grid.coordinates(before))[near_aorta] == pytest.approx(places[near_aorta], abs=1e-6)


def test_another_vessel_in_the_way_keeps_a_stub_as_it_is() -> None:
    beside = straight("beside", (0, 0, 0.06), (0.027, 0, 0.06), 60, 0.003, parent="aorta", parent_arc=0.06)
    of_beside = {"parent": "beside", "parent_arc": beside.length}
    across = straight("across", (0.027, 0, 0.06), (0.027, 0, 0.01), 60, 0.003, **of_beside)
    beside = Branch(beside.name, beside.points, beside.radius, "aorta", 0.06, open_end=False)
    tree = drawn(beside, across)
    grid = build_lumen(tree, resolution=1e-3, fillet_radius=1e-3)
    extended, same, notes = extend_short_branches(tree, grid)
    assert notes == ("stub ends 12 mm behind its ostium: another vessel is in the way of more",)
    assert extended["stub"].length == tree["stub"].length
    assert same is grid


def arch_with(rise: float) -> VesselTree:
    """An aorta over a half circle of 40 mm, and a branch from its far limb that rises at `rise` rad from the x axis."""
    angle = np.linspace(0, np.pi, 181)
    aorta = 0.040 * np.stack((np.cos(angle), 0 * angle, np.sin(angle)), axis=1)
    begins = aorta[120]
    along = np.linspace(0, 0.060, 61)[:, None] * np.array([np.cos(rise), 0.0, np.sin(rise)])
    side = np.linspace(0, 0.030, 31)[:, None] * np.array([0.0, 1.0, 0.0])
    arc = 0.040 * np.radians(120)
    return VesselTree(
        (
            Branch("aorta", aorta, np.full(181, 0.010)),
            Branch("bca", begins + along, np.full(61, 0.004), "aorta", arc),
            Branch("rcca", begins + along[40] + side, np.full(31, 0.003), "bca", 0.040),
        )
    )


def test_it_is_the_way_back_along_the_branch() -> None:
    tree = arch_with(np.pi / 2)
    top = np.array([0.0, 0.0, 0.050])
    assert set_back(tree, "bca") == pytest.approx(top[2] - tree.ostium("bca")[2], abs=1e-5)
    forwards = arch_with(np.radians(150))  # a branch that leads on as the wire comes
    assert set_back(forwards, "bca") < set_back(tree, "bca") < set_back(arch_with(np.radians(60)), "bca")


def test_other_names_are_refused() -> None:
    for name in ("aorta", "lsa"):
        with pytest.raises(ValueError, match="must be that of a branch, bca, rcca"):
            set_back(arch_with(1.0), name)
