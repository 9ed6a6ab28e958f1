"""Vessels that end soon after they leave the aorta are kept; lumens that are too narrow are refused."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from cathsim.anatomy import Branch, MeshRefusedError, Phantom, VesselTree, import_mesh
from cathsim.anatomy.lumen import build_lumen
from cathsim.anatomy.surface import lumen_surface
from cathsim.anatomy.vessel_tree import nearest_on_branch
from tests.cathsim.anatomy.generator.drawn_arch import BOW, LIMB, WIDTH, arch_mesh, arch_tree
from tests.cathsim.anatomy.lumen_report import check_lumen

REAL = Path(__file__).resolve().parents[5] / "shared" / "real" / "aortas"
COARSE = 2e-3
STUB = 0.015  # m: not much longer than the branches are wide


def _in_file(phantom: Phantom, points: np.ndarray) -> np.ndarray:
    """World points in metres of the file's frame."""
    report = phantom.imported
    return (points - np.array(report.offset)) @ np.array(report.rotation)


def _led_on(branch: Branch) -> Branch:
    """A branch that goes straight on, as its extension does."""
    points = np.concatenate([branch.points, branch.points[-1:] + 0.05 * branch.tangents[-1:]])
    return Branch(branch.name, points, np.append(branch.radius, branch.radius[-1]), branch.parent, branch.parent_arc)


def test_short_branches_are_kept_and_the_aorta_is_whole(tmp_path: Path):
    mesh = arch_mesh(STUB)
    mesh.apply_scale(1000)
    mesh.export(tmp_path / "short.stl")
    found = import_mesh(tmp_path / "short.stl", resolution=COARSE, cache_dir=tmp_path)
    drawn = arch_tree(STUB)
    assert set(found.tree.names) == {"aorta", "bca", "lcca", "lsa"}
    assert found.tree.root.length > 0.93 * drawn.root.length
    for name in ("bca", "lcca", "lsa"):
        target = found.targets[name].position
        assert found.grid.sample(target) > 0.5 * drawn[name].radius[0], name
        _, _, aside = nearest_on_branch(_led_on(drawn[name]), _in_file(found, target))
        assert aside[0] < 2.5e-3, name
        assert found.depths.place(target).depth == pytest.approx(0.030, abs=2e-3)
    assert sum("extended by" in note for note in found.imported.notes) == 3
    assert check_lumen(found) == []
    with pytest.raises(MeshRefusedError, match="long enough for a wire and a target; import it with extend=True"):
        import_mesh(tmp_path / "short.stl", extend=False, resolution=COARSE, cache_dir=tmp_path)


def test_a_trunk_that_parts_early_has_a_target(tmp_path: Path):
    """Its centreline ends before its lumen parts, 20 mm behind the ostium."""
    tree = arch_tree(0.03)
    trunk = tree["bca"]
    up = trunk.tangents[0]
    fork = trunk.points[0] + np.linspace(0, WIDTH + 16e-3, 41)[:, None] * up
    trunk = Branch("bca", fork, np.full(41, 6e-3), "aorta", trunk.parent_arc, open_end=False)
    branches = [*(branch for branch in tree if branch.name != "bca"), trunk]
    for name, aside in (("rsa", -1.0), ("rcca", 1.0)):
        way = up + aside * 0.35 * np.array([up[2], 0.0, -up[0]])
        points = fork[-1] + np.linspace(0, 0.045, 41)[:, None] * way / np.linalg.norm(way)
        branches.append(Branch(name, points, np.full(41, 3.5e-3), "bca", trunk.length))
    mesh = lumen_surface(build_lumen(VesselTree(tuple(branches)), resolution=1e-3, fillet_radius=2e-3))
    mesh.apply_scale(1000).export(tmp_path / "trunk.stl")
    found = import_mesh(tmp_path / "trunk.stl", resolution=COARSE, cache_dir=tmp_path)
    assert {"bca", "rsa", "rcca"} <= set(found.targets)
    target = found.targets["bca"].position
    place = found.depths.place(target)
    assert place.branch == "bca"
    assert place.depth == pytest.approx(0.0155, abs=1e-3)
    assert found.grid.sample(target) > 3e-3
    beyond = found.depths.place(found.tree["rcca"].point_at(5e-3))
    assert found.depths.way(beyond, place) == pytest.approx(5e-3, abs=1.5e-3)


def test_a_wide_branch_that_is_cut_soon_after_it_leaves_the_ascending_limb_is_the_first(tmp_path: Path):
    across, width = -0.032, 7.5e-3
    tree = arch_tree(0.03)
    aorta = tree.root
    top = int(aorta.points[:, 2].argmax())
    place = top + int(np.abs(aorta.points[top:, 0] - across).argmin())
    aslant = np.array([-1.0, -0.5, 0.5]) / np.linalg.norm([-1.0, -0.5, 0.5])
    points = aorta.points[place] + np.linspace(0, WIDTH + 0.012, 41)[:, None] * aslant
    bca = Branch("bca", points, np.full(41, width), "aorta", float(aorta.arc[place]))
    drawn = VesselTree((*(branch for branch in tree if branch.name != "bca"), bca))
    mesh = lumen_surface(build_lumen(drawn, resolution=1e-3, fillet_radius=1e-3))
    mesh.apply_scale(1000)
    mesh.export(tmp_path / "stump.stl")
    found = import_mesh(tmp_path / "stump.stl", resolution=COARSE, cache_dir=tmp_path)
    assert found.tree.names == ("aorta", "bca", "lcca", "lsa")
    _, _, aside = nearest_on_branch(_led_on(bca), _in_file(found, found.targets["bca"].position))
    assert aside[0] < 2e-3


def _with_coronaries(above: float) -> VesselTree:
    """The drawn arch with two coronary arteries, whose middles lie some way above its ascending end, m."""
    tree = arch_tree(0.03)
    aorta = tree.root
    arc = aorta.length - above
    branches = list(tree)
    for side in (-1.0, 1.0):
        corners = np.array([[0.0, 0.0, 0.0], [0.0, side * 0.022, 0.0], [0.0, side * 0.028, -0.025]])
        points = aorta.point_at(arc) + np.concatenate(
            [np.linspace(a, b, 20, endpoint=False) for a, b in pairwise(corners)] + [corners[-1:]]
        )
        branches.append(Branch(f"coronary_{side:g}", points, np.full(len(points), 1.8e-3), "aorta", arc))
    return VesselTree(tuple(branches))


def test_coronary_arteries_do_not_hide_the_aortas_end(tmp_path: Path):
    drawn = _with_coronaries(0.004)
    mesh = lumen_surface(build_lumen(drawn, resolution=1e-3, fillet_radius=1e-3))
    mesh.apply_scale(1000)
    mesh.export(tmp_path / "coronaries.stl")
    found = import_mesh(tmp_path / "coronaries.stl", resolution=COARSE, cache_dir=tmp_path)
    assert found.tree.root.length > 0.93 * drawn.root.length
    for name in ("bca", "lcca", "lsa"):
        _, _, aside = nearest_on_branch(_led_on(drawn[name]), _in_file(found, found.targets[name].position))
        assert aside[0] < 3e-3, name


def test_a_stenosis_that_a_wire_can_pass_is_kept(tmp_path: Path):
    mesh = arch_mesh(0.03, narrowed=1.6e-3)
    mesh.apply_scale(1000)
    mesh.export(tmp_path / "narrow.stl")
    found = import_mesh(tmp_path / "narrow.stl", resolution=COARSE, cache_dir=tmp_path)
    assert "distances every 1 mm: the aorta is narrow" in found.imported.notes
    assert 1.2e-3 < found.tree.root.radius.min() < 2.5e-3
    assert check_lumen(found, required_radius=1e-3) == []


def test_a_closed_aorta_is_refused(tmp_path: Path):
    mesh = arch_mesh(0.03)
    points = mesh.vertices.copy()
    tied = (np.abs(points[:, 2] + LIMB / 2) < 3e-3) & (points[:, 0] > 0)
    points[tied, :2] = [BOW, 0.0] + 0.02 * (points[tied, :2] - [BOW, 0.0])
    mesh.vertices = points
    mesh.apply_scale(1000)
    mesh.export(tmp_path / "closed.stl")
    with pytest.raises(MeshRefusedError, match=r"narrow|parts|cannot be followed"):
        import_mesh(tmp_path / "closed.stl", resolution=COARSE, cache_dir=tmp_path)


@pytest.mark.skipif(not REAL.is_dir(), reason="../shared/real/aortas is not there")
@pytest.mark.parametrize(("name", "unit"), [("patient1", "mm"), ("feelpp_aorta2", "cm")])
def test_real_arches_with_short_branches(name: str, unit: str, tmp_path: Path):
    found = import_mesh(REAL / f"{name}.stl", resolution=COARSE, cache_dir=tmp_path)
    assert found.imported.unit == unit
    assert found.imported.borders == 5
    assert found.tree.names == ("aorta", "bca", "lcca", "lsa")
    assert all(branch.parent == "aorta" for branch in found.tree.branches[1:])
    arcs = [found.tree[branch].parent_arc for branch in ("bca", "lcca", "lsa")]
    assert arcs == sorted(arcs, reverse=True)  # from the heart on
    for target in ("bca", "lcca", "lsa"):
        assert found.grid.sample(found.targets[target].position) > 1e-3, target
        assert found.depths.place(found.targets[target].position).depth == pytest.approx(0.030, abs=1e-3)
