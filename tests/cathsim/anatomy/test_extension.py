"""Branches that are cut short go on as tubes of their own width, unless another vessel is in the way."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim.anatomy.extension import DEPTH, extend_short_branches
from cathsim.anatomy.lumen import build_lumen
from cathsim.anatomy.phantom import END_CLEARANCE
from cathsim.anatomy.vessel_tree import Branch, VesselTree

AORTA, RADIUS, STUB = 0.010, 0.004, 0.012  # m


def straight(name: str, start: tuple, end: tuple, radius: float, **of_branch: object) -> Branch:
    points = np.linspace(start, end, 60)
    return Branch(name, points, np.full(60, radius), **of_branch)  # type: ignore[arg-type]


def drawn(*more: Branch) -> VesselTree:
    """A straight aorta along z with a stub along x, and other branches."""
    root = straight("aorta", (0, 0, 0), (0, 0, 0.08), AORTA)
    stub = straight("stub", (0, 0, 0.04), (AORTA + STUB, 0, 0.04), RADIUS, parent="aorta", parent_arc=0.04)
    return VesselTree((root, stub, *more))


def test_a_stub_goes_on_along_its_direction_with_its_radius() -> None:
    tree = drawn()
    grid = build_lumen(tree, resolution=1e-3, fillet_radius=1e-3)
    extended, longer, notes = extend_short_branches(tree, grid)
    stub = extended["stub"]
    assert notes == (
        "stub is cut 12 mm behind its ostium, and extended by 23 mm along its direction (extend=False leaves it)",
    )
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
    beside = straight("beside", (0, 0, 0.06), (0.027, 0, 0.06), 0.003, parent="aorta", parent_arc=0.06)
    across = straight("across", (0.027, 0, 0.06), (0.027, 0, 0.01), 0.003, parent="beside", parent_arc=beside.length)
    beside = Branch(beside.name, beside.points, beside.radius, "aorta", 0.06, open_end=False)
    tree = drawn(beside, across)
    grid = build_lumen(tree, resolution=1e-3, fillet_radius=1e-3)
    extended, same, notes = extend_short_branches(tree, grid)
    assert notes == ("stub ends 12 mm behind its ostium: another vessel is in the way of more",)
    assert extended["stub"].length == tree["stub"].length
    assert same is grid
