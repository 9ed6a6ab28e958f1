"""Arches with wide stumps, short branches, narrow lumens and rings: where vessels end and what they are called."""

import itertools
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

from cathsim.anatomy import Branch, MeshRefusedError, Phantom, VesselTree, import_anatomy
from cathsim.anatomy.lumen import build_lumen
from cathsim.anatomy.mesh.aortic_ends import aortic_ends
from cathsim.anatomy.mesh.arches.arch_naming import name_vessels
from cathsim.anatomy.mesh.branches import RoughVessel
from cathsim.anatomy.mesh.reading import Triangles
from cathsim.anatomy.mesh.surface_import import SurfaceFacts, phantom_of_surface
from cathsim.anatomy.surface import lumen_surface
from cathsim.anatomy.vessel_tree import nearest_on_branch
from tests.cathsim.anatomy.generator.drawn_arch import BOW, LIMB, WIDTH, arch_mesh, arch_tree
from tests.cathsim.anatomy.lumen_report import check_lumen

DESCENDING, ASCENDING, ARCH = 0.13, 0.05, 0.04  # m: lengths of the limbs, radius of the arch


def smooth(points: np.ndarray, step: float = 1e-3) -> np.ndarray:
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0.0, arc[-1], round(arc[-1] / step) + 1)
    return np.stack([np.interp(at, arc, points[:, k]) for k in range(3)], axis=1)


def aorta(
    radius: float, ascending: float, bulge: float, limbs: tuple[float, float] = (DESCENDING, ASCENDING)
) -> Branch:
    """From the descending end on; the radius grows to that of the ascending limb, and bulges at the distal arch."""
    angle = np.linspace(0, np.pi, 200)[:, None]
    turn = ARCH * np.concatenate([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
    low, high = np.array([[ARCH, 0, -limbs[0]]]), np.array([[-ARCH, 0, -limbs[1]]])
    points = smooth(np.concatenate([low, turn, high]))
    arc = np.arange(len(points)) * 1e-3
    at = limbs[0] + 0.3 * np.pi * ARCH
    grown = radius + (ascending - radius) * np.clip((arc - limbs[0]) / (np.pi * ARCH), 0, 1)
    return Branch("aorta", points, grown + bulge * np.exp(-(((arc - at) / 0.02) ** 2)))


def branch(
    name: str, root: Branch, share: float, radius: float, beyond: float, descending: float = DESCENDING
) -> Branch:
    """Straight out of the arch at a share of its half turn."""
    arc = descending + share * np.pi * ARCH
    origin, out = root.point_at(arc), np.array([np.cos(share * np.pi), 0.25, np.sin(share * np.pi)])
    length = float(root.radius_at(arc)) + beyond
    points = origin + np.arange(0.0, length, 1e-3)[:, None] * out / np.linalg.norm(out)
    return Branch(name, points, np.full(len(points), radius), "aorta", arc)


def imported_in_metres(tree: VesselTree, path: Path) -> Phantom:
    lumen_surface(build_lumen(tree, resolution=1e-3, fillet_radius=3e-3)).export(path)
    return import_anatomy(path, unit="m", resolution=2e-3, cache_dir=path.parent / "cache")


@pytest.mark.parametrize("ascending", [ASCENDING, 0.015])
def test_a_stump_that_is_wider_than_the_aorta_is_no_end_of_it_and_does_not_turn_it(
    ascending: float, tmp_path: Path
) -> None:
    root = aorta(0.0112, 0.0135, bulge=0.008, limbs=(DESCENDING, ascending))
    stump = branch("lsa", root, 0.3, 0.0168, beyond=0.018)
    others = [branch(name, root, share, 0.0045, beyond=0.045) for name, share in (("lcca", 0.56), ("bca", 0.72))]
    phantom = imported_in_metres(VesselTree((root, stump, *others)), tmp_path / "aneurysm.stl")
    ends = phantom.tree.root.points[[0, -1]]
    radii = phantom.tree.root.radius_at([0.01, phantom.tree.root.length - 0.01])
    assert radii == pytest.approx([0.0112, 0.0135], abs=1e-3)
    assert ends[0, 2] < ends[1, 2] - 0.06  # the descending limb is longer
    assert phantom.tree.root.length == pytest.approx(root.length, abs=0.01)
    assert phantom.tree.names == ("aorta", "bca", "lcca", "lsa")
    doubts = [note for note in phantom.imported.notes if "may end elsewhere" in note]  # type: ignore[union-attr]
    assert len(doubts) == 1  # the stump is large
    assert phantom.depths.place(phantom.target("lsa").position).depth == pytest.approx(0.030, abs=0.002)


def test_an_aorta_of_two_equal_limbs_lies_as_the_patients_axes_say_and_without_them_a_doubt_is_told() -> None:
    root = aorta(0.012, 0.012, bulge=0.0, limbs=(0.05, 0.05))
    sides = [branch(f"b{share}", root, share, 0.0045, beyond=0.045, descending=0.05) for share in (0.4, 0.6)]
    mesh = lumen_surface(build_lumen(VesselTree((root, *sides)), resolution=1e-3, fillet_radius=3e-3))
    surface = Triangles(mesh.vertices, mesh.faces)
    for side in (1.0, -1.0, None):
        frame = None if side is None else np.diag([side, side, 1.0])
        phantom = phantom_of_surface(surface, SurfaceFacts("arch"), name="a", digest="a", resolution=2e-3, frame=frame)
        assert phantom.tree.root.points[0, 0] > 0.02 > -0.02 > phantom.tree.root.points[-1, 0]  # descends on the left
        doubts = [note for note in phantom.imported.notes if "which of the aorta's two ends" in note]  # type: ignore[union-attr]
        assert len(doubts) == (side is None)


def way(*parts: tuple[str, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Points and depths of a way along named straight parts, each of a length and a radius."""
    axes = {"stem": (0, 0, 1), "one": (1, 0, 0.5), "other": (-1, 0, 0.5), "twig": (0, 1, 0)}
    points, depths = [np.zeros((1, 3))], [np.array([parts[0][2]])]
    for name, length, radius in parts:
        arc = np.arange(1e-3, length + 1e-9, 1e-3)[:, None]
        points.append(points[-1][-1] + arc * np.array(axes[name]) / np.linalg.norm(axes[name]))
        depths.append(np.full(len(arc), radius))
    return np.concatenate(points), np.concatenate(depths)


def test_a_vessel_that_is_nearly_as_large_as_the_aorta_beyond_a_fork_is_told() -> None:
    radii = [0.012, 0.011, 0.011, 0.004]
    for other, unsure in ((0.05, (2,)), (0.01, ())):  # as wide, and a little or far shorter
        ways = [
            way(("stem", 0.06, 0.012), ("one", 0.06, 0.011)),
            way(("stem", 0.06, 0.012), ("other", other, 0.011)),
            way(("stem", 0.06, 0.012), ("twig", 0.15, 0.004)),
        ]
        first, last, doubted = aortic_ends([points for points, _ in ways], [depths for _, depths in ways], radii)
        assert ({first, last}, doubted) == ({0, 1}, unsure)


def test_an_aorta_without_an_arch_has_no_branches_to_head_and_arms_and_does_not_confirm_a_unit(tmp_path: Path) -> None:
    points = np.array([0.0, 0.0, 1e-3]) * np.arange(120)[:, None]
    root = Branch("aorta", points, np.full(120, 0.010))
    sides = [
        Branch(name, points[at] + np.outer(np.arange(45) * 1e-3, way), np.full(45, 0.003), "aorta", at * 1e-3)
        for name, at, way in (("left", 45, (0.9, 0, 0.43)), ("right", 60, (-0.9, 0, 0.43)))
    ]
    mesh = lumen_surface(build_lumen(VesselTree((root, *sides)), resolution=1e-3, fillet_radius=3e-3))
    mesh.apply_scale(100).export(tmp_path / "straight.stl")
    for unit in ("cm", None):  # given, and detected: it could be a carotid artery's in millimetres
        phantom = import_anatomy(tmp_path / "straight.stl", unit=unit, resolution=2e-3, cache_dir=tmp_path / "cache")
        assert set(phantom.tree.names) == {"aorta", "branch_1", "branch_2"}
        assert phantom.target("branch_1").branch == "branch_1"
        notes = phantom.imported.notes  # type: ignore[union-attr]
        assert any("there is no arch" in note for note in notes)
        assert sum(note.startswith("cm is the unit by an aorta's width") for note in notes) == (unit is None)


REAL = Path(__file__).resolve().parents[5] / "shared" / "real" / "aortas"
COARSE = 2e-3
STUB = 0.015  # m: not much longer than the branches are wide


def _imported(mesh: trimesh.Trimesh | VesselTree, folder: Path, fillet: float = 1e-3) -> Phantom:
    """The import of a surface, or of that of a drawn tree, from a file in millimetres."""
    if isinstance(mesh, VesselTree):
        mesh = lumen_surface(build_lumen(mesh, resolution=1e-3, fillet_radius=fillet))
    mesh.apply_scale(1000).export(folder / "drawn.stl")
    return import_anatomy(folder / "drawn.stl", resolution=COARSE, cache_dir=folder)


def _in_file(phantom: Phantom, points: np.ndarray) -> np.ndarray:
    """World points in metres of the file's frame."""
    report = phantom.imported
    return (points - np.array(report.offset)) @ np.array(report.rotation)


def _led_on(branch: Branch) -> Branch:
    """A branch that goes straight on, as its extension does."""
    points = np.concatenate([branch.points, branch.points[-1:] + 0.05 * branch.tangents[-1:]])
    return Branch(branch.name, points, np.append(branch.radius, branch.radius[-1]), branch.parent, branch.parent_arc)


def test_short_branches_are_kept_and_the_aorta_is_whole(tmp_path: Path):
    found = _imported(arch_mesh(STUB), tmp_path)
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
    with pytest.raises(MeshRefusedError, match="import it with extend=True"):
        import_anatomy(tmp_path / "drawn.stl", extend=False, resolution=COARSE, cache_dir=tmp_path)


def test_a_trunk_that_parts_early_has_a_target_and_coronary_arteries_do_not_hide_the_aortas_end(tmp_path: Path):
    """The trunk's centreline ends before its lumen parts, 20 mm behind the ostium.

    The middles of two coronary arteries lie 4 mm above the ascending end.
    """
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
    arc = tree.root.length - 0.004
    for side in (-1.0, 1.0):
        corners = np.array([[0.0, 0.0, 0.0], [0.0, side * 0.022, 0.0], [0.0, side * 0.028, -0.025]])
        pieces = [np.linspace(a, b, 20, endpoint=False) for a, b in pairwise(corners)]
        points = tree.root.point_at(arc) + np.concatenate([*pieces, corners[-1:]])
        branches.append(Branch(f"coronary_{side:g}", points, np.full(len(points), 1.8e-3), "aorta", arc))
    found = _imported(VesselTree(tuple(branches)), tmp_path, fillet=2e-3)
    assert found.tree.root.length > 0.93 * tree.root.length
    for name in ("bca", "lcca", "lsa"):
        _, _, aside = nearest_on_branch(_led_on(tree[name]), _in_file(found, found.targets[name].position))
        assert aside[0] < 3e-3, name
    assert {"bca", "rsa", "rcca"} <= set(found.targets)
    target = found.targets["bca"].position
    place = found.depths.place(target)
    assert place.branch == "bca"
    assert place.depth == pytest.approx(0.0155, abs=1e-3)
    assert found.grid.sample(target) > 3e-3
    beyond = found.depths.place(found.tree["rcca"].point_at(5e-3))
    assert found.depths.way(beyond, place) == pytest.approx(5e-3, abs=1.5e-3)


def test_a_wide_branch_of_the_ascending_limb_is_the_first_and_a_stenosis_that_a_wire_can_pass_is_kept(tmp_path: Path):
    """The branch is cut soon after it leaves the aorta, whose descending limb is narrow."""
    across, width = -0.032, 7.5e-3
    tree = arch_tree(0.03, narrowed=1.6e-3)
    aorta = tree.root
    top = int(aorta.points[:, 2].argmax())
    place = top + int(np.abs(aorta.points[top:, 0] - across).argmin())
    aslant = np.array([-1.0, -0.5, 0.5]) / np.linalg.norm([-1.0, -0.5, 0.5])
    points = aorta.points[place] + np.linspace(0, WIDTH + 0.012, 41)[:, None] * aslant
    bca = Branch("bca", points, np.full(41, width), "aorta", float(aorta.arc[place]))
    found = _imported(VesselTree((*(branch for branch in tree if branch.name != "bca"), bca)), tmp_path)
    assert found.tree.names == ("aorta", "bca", "lcca", "lsa")
    _, _, aside = nearest_on_branch(_led_on(bca), _in_file(found, found.targets["bca"].position))
    assert aside[0] < 2e-3
    assert any("the aorta is narrow" in note for note in found.imported.notes)
    assert 1.2e-3 < found.tree.root.radius.min() < 2.5e-3
    assert check_lumen(found, required_radius=1e-3) == []


def test_a_closed_aorta_is_refused(tmp_path: Path):
    mesh = arch_mesh(0.03)
    points = mesh.vertices.copy()
    tied = (np.abs(points[:, 2] + LIMB / 2) < 3e-3) & (points[:, 0] > 0)
    points[tied, :2] = [BOW, 0.0] + 0.02 * (points[tied, :2] - [BOW, 0.0])
    mesh.vertices = points
    with pytest.raises(MeshRefusedError, match=r"narrow|parts|cannot be followed"):
        _imported(mesh, tmp_path)


@pytest.mark.skipif(not REAL.is_dir(), reason="../shared/real/aortas is not there")
@pytest.mark.parametrize(("name", "unit"), [("patient1", "mm"), ("feelpp_aorta2", "cm")])
def test_real_arches_with_short_branches(name: str, unit: str, tmp_path: Path):
    found = import_anatomy(REAL / f"{name}.stl", resolution=COARSE, cache_dir=tmp_path)
    assert found.imported.unit == unit
    assert found.imported.borders == 5
    assert found.tree.names == ("aorta", "bca", "lcca", "lsa")
    assert all(branch.parent == "aorta" for branch in found.tree.branches[1:])
    arcs = [found.tree[branch].parent_arc for branch in ("bca", "lcca", "lsa")]
    assert arcs == sorted(arcs, reverse=True)  # from the heart on
    for target in ("bca", "lcca", "lsa"):
        assert found.grid.sample(found.targets[target].position) > 1e-3, target
        assert found.depths.place(found.targets[target].position).depth == pytest.approx(0.030, abs=1e-3)


PAIR = ("lcca", "bca")
SPACING = 1.5e-3  # m
RADIUS = 3e-3  # m, of the vessel that closes the ring


@pytest.fixture(scope="module")
def link() -> np.ndarray:
    """Middle (n, 3) m of a vessel from the LCCA's end over the head to the BCA's."""
    tree = arch_tree(0.045)
    (first, up), (last, _) = ((b.points[-6], b.points[-1] - b.points[-6]) for b in map(tree.__getitem__, PAIR))
    angles = np.linspace(0, np.pi, 80)[:, None]
    across = (last - first) / 2
    return (first + last) / 2 - np.cos(angles) * across + np.sin(angles) * up / np.linalg.norm(up) * 0.03


@pytest.fixture(scope="module")
def ring(link: np.ndarray, cache: Path) -> Phantom:
    grid = build_lumen(arch_tree(0.045), resolution=1e-3, fillet_radius=2e-3)
    low, high = grid.bounds[0] - 3e-3, np.maximum(grid.bounds[1], link.max(axis=0) + RADIUS) + 3e-3
    axes = [np.arange(a, b, SPACING) for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    lumen = np.maximum(grid.sample(points), RADIUS - cKDTree(link).query(points)[0])
    corners, faces, *_ = marching_cubes(lumen, 0.0)
    path = cache / "ring.stl"
    trimesh.Trimesh((low + corners * SPACING) * 1e3, faces[:, ::-1]).export(path)
    return import_anatomy(path, unit="mm", resolution=SPACING, cache_dir=cache)


def _in_import(points: np.ndarray, ring: Phantom) -> np.ndarray:
    report = ring.imported
    return points @ np.array(report.rotation).T + np.array(report.offset)


def test_a_ring_is_told_and_nothing_closes_it(ring: Phantom, link: np.ndarray) -> None:
    assert any("a ring" in note for note in ring.imported.notes), ring.imported.notes
    assert {"bca", "lcca", "lsa"} <= set(ring.tree.names)
    assert ring.grid.sample(_in_import(link, ring)).min() > RADIUS - SPACING
    ends = {name for name in ring.targets if name.endswith("_end")}
    assert ends == {"lsa_end"}, "where vessels of a ring meet there is no open end"


def test_centrelines_meet_in_the_ring_and_ways_go_the_shorter_side(ring: Phantom, link: np.ndarray) -> None:
    tips = [ring.tree[name].points[-1] for name in PAIR]
    assert np.linalg.norm(tips[0] - tips[1]) < 0.02
    top = tuple(_in_import(link[40], ring).tolist())
    lengths = [ring.geodesic_distance(_in_import(link[i], ring), top) for i in (0, 79)]
    chords = [np.linalg.norm(np.diff(part, axis=0), axis=1).sum() for part in (link[:41], link[40:])]
    np.testing.assert_allclose(lengths, chords, rtol=0.1)  # from either side; a wall would make one of them a detour


def _vessel(*corners: tuple[float, float, float], radius: float, start: float = 0.0) -> RoughVessel:
    points = np.concatenate([np.linspace(a, b, 60) for a, b in itertools.pairwise(corners)])
    return RoughVessel(points, np.full(len(points), radius), 0, [], start)


def test_a_subclavian_artery_goes_to_the_arm_and_the_vertebral_one_to_the_head() -> None:
    aorta = _vessel((0.05, 0.02, -0.15), (0.05, 0.02, 0.0), (-0.02, -0.02, 0.0), (-0.02, -0.02, -0.05), radius=0.012)
    right = _vessel((-0.02, -0.02, 0.0), (-0.04, -0.02, 0.06), radius=0.005, start=0.23)
    middle = _vessel((0.0, 0.0, 0.0), (0.0, 0.0, 0.15), radius=0.004, start=0.2)
    left = _vessel((0.04, 0.01, 0.0), (0.06, 0.01, 0.03), (0.06, 0.01, 0.2), radius=0.004, start=0.16)
    arm = _vessel((0.06, 0.01, 0.03), (0.15, 0.01, 0.02), radius=0.003, start=0.036)
    left.children = [arm]
    aorta.children = [left, middle, right]
    names, _ = name_vessels(aorta, sides_known=True)
    by_name = {names[id(vessel)]: vessel for vessel in aorta.every}
    assert by_name["lsa"].points[-1].tolist() == [0.15, 0.01, 0.02]
    assert by_name["vertebral_left"].points[-1].tolist() == [0.06, 0.01, 0.2]
