"""Names of vessels follow the arch and the user; targets follow the room in a branch."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim.anatomy import MeshRefusedError
from cathsim.anatomy.mesh.arches.arch_naming import name_vessels
from cathsim.anatomy.mesh.branches import RoughVessel
from cathsim.anatomy.mesh.naming import ordered_names, propose_targets, renamed, world_rotation
from cathsim.anatomy.vessel_tree import Branch, VesselTree


def _vessel(start: list[float], end: list[float], radius: float, number: int | None) -> RoughVessel:
    points = np.linspace(start, end, 40)
    return RoughVessel(points, np.full(40, radius), number)


def _arch() -> RoughVessel:
    angle = np.linspace(0, np.pi, 60)
    bow = np.stack([0.035 * np.cos(angle), 0 * angle, 0.035 * np.sin(angle)], axis=1)
    down = np.linspace([0.035, 0, -0.1], [0.035, 0, 0], 60)
    aorta = RoughVessel(np.concatenate([down, bow]), np.full(120, 0.012), 0)
    for x, radius, number in ((0.02, 0.004, 1), (0.0, 0.0035, 2), (-0.02, 0.006, 3)):
        child = _vessel([x, 0, 0.03], [1.5 * x, 0, 0.09], radius, number)
        child.start = 0.1 + 0.035 * (np.arccos(x / 0.035))
        aorta.children.append(child)
    return aorta


def test_names_follow_the_arch_and_the_users():
    aorta = _arch()
    rotation, kept = world_rotation(aorta)
    assert kept is False or np.allclose(np.abs(rotation).max(axis=1), 1)
    assert rotation[2] @ [0, 0, 1] > 0.95
    names, notes = name_vessels(aorta)
    assert [names[id(child)] for child in aorta.children] == ["lsa", "lcca", "bca"]
    assert notes == ()
    assert ordered_names(aorta, names, ["a", "b", "c"]) == {"bca": "a", "lcca": "b", "lsa": "c"}
    swapped = renamed(names, {"lcca": "lsa", "lsa": "lcca"})
    assert [swapped[id(child)] for child in aorta.children] == ["lcca", "lsa", "bca"]
    with pytest.raises(MeshRefusedError, match="names refer to rca, which was not found; found are aorta, "):
        renamed(names, {"rca": "bca"})
    with pytest.raises(MeshRefusedError, match="names must differ"):
        renamed(names, {"lcca": "lsa"})
    with pytest.raises(
        MeshRefusedError, match=r"2 names were given for the 3 branches of the aorta \(bca, lcca, lsa\)"
    ):
        ordered_names(aorta, names, ["a", "b"])


def test_a_common_trunk_is_recognised():
    aorta = _arch()
    del aorta.children[1]
    left = _vessel([-0.02, 0, 0.05], [0.025, 0, 0.09], 0.0035, 4)
    aorta.children[-1].children.append(left)
    names, notes = name_vessels(aorta)
    assert names[id(left)] == "lcca"
    assert [names[id(child)] for child in aorta.children] == ["lsa", "bca"]
    assert "common trunk" in notes[0]


def test_targets_move_into_short_branches(tee: VesselTree):
    targets, notes = propose_targets(tee)
    assert targets["bca"].arc == pytest.approx(tee["bca"].length - 5e-3)
    assert notes == ("target bca lies 27 mm up its branch instead of 30: the branch is short",)
    stub = Branch("bca", tee["bca"].points[:16], tee["bca"].radius[:16], "aorta", 0.04)
    targets, notes = propose_targets(VesselTree((tee.root, stub)))
    assert targets == {}
    assert notes == ("no target in bca: it is only 7 mm long",)
