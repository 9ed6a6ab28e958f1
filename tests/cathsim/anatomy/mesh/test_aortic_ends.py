"""The aorta's ends are those of the largest tube, whatever the radii of the openings; and where there is no arch."""

from pathlib import Path

import numpy as np
import pytest

from cathsim.anatomy import Phantom, import_mesh
from cathsim.anatomy.lumen import build_lumen
from cathsim.anatomy.mesh.aortic_ends import aortic_ends
from cathsim.anatomy.surface import lumen_surface
from cathsim.anatomy.vessel_tree import Branch, VesselTree

DESCENDING, ASCENDING, ARCH = 0.13, 0.05, 0.04  # m: lengths of the limbs, radius of the arch


def smooth(points: np.ndarray, step: float = 1e-3) -> np.ndarray:
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0.0, arc[-1], round(arc[-1] / step) + 1)
    return np.stack([np.interp(at, arc, points[:, k]) for k in range(3)], axis=1)


def aorta(radius: float, ascending: float, bulge: float) -> Branch:
    """From the descending end on; the radius grows to that of the ascending limb, and bulges at the distal arch."""
    angle = np.linspace(0, np.pi, 200)[:, None]
    turn = ARCH * np.concatenate([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
    low, high = np.array([[ARCH, 0, -DESCENDING]]), np.array([[-ARCH, 0, -ASCENDING]])
    points = smooth(np.concatenate([low, turn, high]))
    arc = np.arange(len(points)) * 1e-3
    at = DESCENDING + 0.3 * np.pi * ARCH
    grown = radius + (ascending - radius) * np.clip((arc - DESCENDING) / (np.pi * ARCH), 0, 1)
    return Branch("aorta", points, grown + bulge * np.exp(-(((arc - at) / 0.02) ** 2)))


def branch(name: str, root: Branch, share: float, radius: float, beyond: float) -> Branch:
    """Straight out of the arch at a share of its half turn."""
    arc = DESCENDING + share * np.pi * ARCH
    origin, out = root.point_at(arc), np.array([np.cos(share * np.pi), 0.25, np.sin(share * np.pi)])
    length = float(root.radius_at(arc)) + beyond
    points = origin + np.arange(0.0, length, 1e-3)[:, None] * out / np.linalg.norm(out)
    return Branch(name, points, np.full(len(points), radius), "aorta", arc)


def imported(tree: VesselTree, path: Path) -> Phantom:
    lumen_surface(build_lumen(tree, resolution=1e-3, fillet_radius=3e-3)).export(path)
    return import_mesh(path, unit="m", resolution=2e-3, cache_dir=path.parent / "cache")


def test_a_stump_that_is_wider_than_the_aorta_is_no_end_of_it(tmp_path: Path) -> None:
    root = aorta(0.0112, 0.0135, bulge=0.008)
    stump = branch("lsa", root, 0.3, 0.0168, beyond=0.018)
    others = [branch(name, root, share, 0.0045, beyond=0.045) for name, share in (("lcca", 0.56), ("bca", 0.72))]
    phantom = imported(VesselTree((root, stump, *others)), tmp_path / "aneurysm.stl")
    ends = phantom.tree.root.points[[0, -1]]
    radii = phantom.tree.root.radius_at([0.01, phantom.tree.root.length - 0.01])
    assert radii == pytest.approx([0.0112, 0.0135], abs=1e-3)
    assert ends[0, 2] < ends[1, 2] - 0.06  # the descending limb is longer
    assert phantom.tree.root.length == pytest.approx(root.length, abs=0.01)
    assert phantom.tree.names == ("aorta", "bca", "lcca", "lsa")
    doubts = [note for note in phantom.imported.notes if "may end elsewhere" in note]  # type: ignore[union-attr]
    assert len(doubts) == 1  # the stump is large
    assert phantom.depths.place(phantom.target("lsa").position).depth == pytest.approx(0.030, abs=0.002)


def way(*parts: tuple[str, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Points and depths of a way along named straight parts, each of a length and a radius."""
    axes = {"stem": (0, 0, 1), "one": (1, 0, 0.5), "other": (-1, 0, 0.5), "twig": (0, 1, 0)}
    points, depths = [np.zeros((1, 3))], [np.array([parts[0][2]])]
    for name, length, radius in parts:
        arc = np.arange(1e-3, length + 1e-9, 1e-3)[:, None]
        points.append(points[-1][-1] + arc * np.array(axes[name]) / np.linalg.norm(axes[name]))
        depths.append(np.full(len(arc), radius))
    return np.concatenate(points), np.concatenate(depths)


@pytest.mark.parametrize(
    ("other", "unsure"),
    [
        (0.05, (2,)),  # as wide, and a little shorter
        (0.01, ()),  # as wide, but far shorter
    ],
)
def test_a_vessel_that_is_nearly_as_large_as_the_aorta_beyond_a_fork_is_told(
    other: float, unsure: tuple[int, ...]
) -> None:
    ways = [
        way(("stem", 0.06, 0.012), ("one", 0.06, 0.011)),
        way(("stem", 0.06, 0.012), ("other", other, 0.011)),
        way(("stem", 0.06, 0.012), ("twig", 0.15, 0.004)),
    ]
    radii = [0.012, 0.011, 0.011, 0.004]
    first, last, doubted = aortic_ends([points for points, _ in ways], [depths for _, depths in ways], radii)
    assert ({first, last}, doubted) == ({0, 1}, unsure)


def test_an_aorta_without_an_arch_has_no_branches_to_head_and_arms(tmp_path: Path) -> None:
    points = np.array([0.0, 0.0, 1e-3]) * np.arange(150)[:, None]
    root = Branch("aorta", points, np.full(150, 0.010))
    sides = [
        Branch(name, points[at] + np.outer(np.arange(50) * 1e-3, way), np.full(50, 0.003), "aorta", at * 1e-3)
        for name, at, way in (("left", 60, (0.9, 0, 0.43)), ("right", 80, (-0.9, 0, 0.43)))
    ]
    phantom = imported(VesselTree((root, *sides)), tmp_path / "straight.stl")
    assert set(phantom.tree.names) == {"aorta", "branch_1", "branch_2"}
    assert phantom.target("branch_1").branch == "branch_1"
    none = "there is no arch of the aorta: its branches have numbers, and no names"
    assert none in phantom.imported.notes  # type: ignore[union-attr]
