"""How far an ostium is set back: known arches, a branch of a branch, growing type, other names."""

import numpy as np
import pytest

from cathsim.anatomy import Branch, VesselTree
from cathsim.anatomy.generator.aortic_arch import build_arch
from cathsim.anatomy.generator.arch_parameters import ArchParameters
from cathsim.anatomy.vessel_tree import set_back


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


def test_of_a_branch_of_a_trunk_the_larger_counts() -> None:
    tree = arch_with(np.pi / 2)
    assert set_back(tree, "rcca") == set_back(tree, "bca")  # across the plane of the arch: itself 0
    tree = arch_with(np.radians(150))
    assert set_back(tree, "bca") < 0
    assert set_back(tree, "rcca") == pytest.approx(-0.004, abs=1e-4)  # beyond the wall of the trunk


def test_it_grows_with_the_type_of_the_arch() -> None:
    found = [set_back(build_arch(ArchParameters(apex_ratio=ratio)), "lcca") for ratio in (0.3, 1.5, 2.7)]
    assert found == sorted(found)
    assert found[-1] - found[0] > 0.005


@pytest.mark.parametrize("name", ["aorta", "lsa"])
def test_other_names_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match="must be that of a branch, bca, rcca"):
        set_back(arch_with(1.0), name)
