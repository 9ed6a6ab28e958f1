"""Anatomies in parts: one file a vessel, nodes of a scene, pieces of one file become one lumen."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.ndimage import gaussian_filter
from skimage.measure import marching_cubes

from cathsim.anatomy import Branch, MeshRefusedError, VesselTree, import_anatomy
from cathsim.anatomy.lumen import build_lumen
from cathsim.anatomy.mesh.lattice import Budget
from cathsim.anatomy.mesh.parts.union import unite
from cathsim.anatomy.mesh.parts.vessel_parts import Part, is_folder_of_parts, pieces, read_parts
from cathsim.anatomy.mesh.reading import Triangles
from cathsim.anatomy.surface import lumen_surface
from cathsim.anatomy.vessel_tree import nearest_on_branch
from cathsim.anatomy.volume.files.reading import is_volume_path
from tests.cathsim.anatomy.generator.drawn_arch import arch_tree
from tests.cathsim.anatomy.lumen_report import check_lumen

COARSE = 2e-3
FILES = {"aorta": "aorta.stl", "bca": "brachiocephalic_trunk.stl", "lcca": "left_common_carotid.obj", "lsa": "LSA.ply"}


@pytest.fixture(scope="module")
def vessels() -> dict[str, trimesh.Trimesh]:
    """Closed tubes in millimetres; the branches begin within the aorta."""
    return {branch.name: _tube(branch.points, branch.radius) for branch in arch_tree(0.03)}


def _tube(points: np.ndarray, radius: np.ndarray) -> trimesh.Trimesh:
    tree = VesselTree((Branch("tube", points, radius),))
    return lumen_surface(build_lumen(tree, resolution=1.5e-3, fillet_radius=2e-3)).apply_scale(1000)


def test_a_folder_with_a_file_a_vessel(vessels: dict[str, trimesh.Trimesh], tmp_path: Path):
    folder = tmp_path / "patient"
    folder.mkdir()
    for name, file in FILES.items():
        vessels[name].export(folder / file)
    vessels["lsa"].copy().apply_translation([200, 0, 0]).export(folder / "left_brachiocephalic_vein.stl")
    within_aorta = 1e3 * arch_tree(0.03).root.points[50]
    trimesh.creation.icosphere(3, 3.0).apply_translation(within_aorta).export(folder / "RSA.stl")
    assert is_folder_of_parts(folder)
    assert not is_folder_of_parts(tmp_path)
    found = import_anatomy(folder, resolution=COARSE, cache_dir=tmp_path / "cache")
    assert set(found.tree.names) == {"aorta", "bca", "lcca", "lsa"}
    assert check_lumen(found) == []
    report = found.imported
    assert any(note.startswith("1 of 6 parts left out") for note in report.notes)
    assert "united from 5 parts" in report.notes
    assert "not found, though there are parts of that name: rsa" in report.notes
    assert found.tree["bca"].parent_arc > found.tree["lsa"].parent_arc
    drawn = arch_tree(0.03)
    assert float(np.median(found.tree.root.radius)) == pytest.approx(float(np.median(drawn.root.radius)), rel=0.03)
    assert float(found.tree["lcca"].radius[-5]) == pytest.approx(4.0e-3, rel=0.06)


def test_a_folder_of_surfaces_may_hold_hidden_files_and_the_ct_beside_them(tmp_path: Path) -> None:
    nibabel = pytest.importorskip("nibabel")
    for name in ("aorta.stl", "lcca.stl"):
        trimesh.creation.icosphere(2, 20.0).export(tmp_path / name)
    (tmp_path / "._aorta.stl").write_bytes(b"\x00\x05\x16\x07")
    nibabel.save(nibabel.Nifti1Image(np.zeros((8, 8, 8), np.int16), np.eye(4)), tmp_path / "ct.nii.gz")
    assert not is_volume_path(tmp_path)
    assert [part.name for part in read_parts(tmp_path).parts] == ["aorta", "lcca"]
    nibabel.save(nibabel.Nifti1Image(np.ones((8, 8, 8), np.uint8), np.eye(4)), tmp_path / "aorta.nii.gz")
    assert is_volume_path(tmp_path)


def test_a_scene_names_its_parts_and_without_an_arch_every_known_artery_is_taken(tmp_path: Path):
    def read(*names: str) -> tuple[list[str], tuple[str, ...]]:
        scene = trimesh.Scene()
        for k, name in enumerate(names):
            mesh = trimesh.creation.capsule(100.0, 10.0).apply_translation([15.0 * k, 0.0, 0.0])
            scene.add_geometry(mesh, node_name=name, geom_name=name)
        scene.export(tmp_path / "scene.glb")
        surface = read_parts(tmp_path / "scene.glb")
        assert surface.faces == sum(len(mesh.faces) for mesh in scene.geometry.values())
        return sorted(part.name for part in surface.parts), surface.notes

    names, notes = read(*(f"VHM_{file.split('.')[0]}" for file in FILES.values()), "VHM_left_renal_vein")
    assert names == ["aorta", "bca", "lcca", "lsa"]
    assert notes[0].startswith("1 of 5 parts left out")
    abdomen = ("abdominal aorta", "right renal artery", "celiac trunk", "right hepatic artery", "left renal vein")
    assert read(*abdomen)[0] == ["aorta", "celiac", "renal_right"]
    assert read(*abdomen, "left subclavian artery")[0] == ["aorta", "lsa"]


@pytest.mark.parametrize("kind", ["o", "g", "solid"])
def test_objects_groups_and_solids_name_their_parts_as_nodes_do(kind: str, tmp_path: Path):
    path = tmp_path / ("a.stl" if kind == "solid" else "a.obj")

    def save(*names: str) -> Path:
        content, before = "", 0
        for k, name in enumerate(names):
            tube = trimesh.creation.capsule(100.0, 10.0).apply_translation([15.0 * k, 0.0, 0.0])
            if kind == "solid":
                content += tube.export(file_type="stl_ascii").replace("solid ", f"solid {name}")
                continue
            points = "".join(f"v {x} {y} {z}\n" for x, y, z in tube.vertices)
            content += f"{kind} {name}\n{points}" + "".join(f"f {a} {b} {c}\n" for a, b, c in tube.faces + before + 1)
            before += len(tube.vertices)
        path.write_text(content)
        return path

    found = read_parts(save("left_subclavian", "inferior_vena_cava", "Aorta_Mesh.001"))
    assert {part.name: float(part.mesh.bounds[0, 0]) for part in found.parts} == pytest.approx(
        {"lsa": -10.0, "aorta": 20.0}
    )
    assert found.notes[0].endswith(": inferior_vena_cava")
    assert read_parts(save("aorta_with_branches", "vein")).notes[0].endswith(": vein")
    with pytest.raises(MeshRefusedError, match="no part that is named after an artery"):
        read_parts(save("vein", "bone"))
    (alone,) = read_parts(save("lumen", "spine")).parts
    assert (alone.name, float(alone.mesh.bounds[1, 0])) == ("", pytest.approx(10.0))
    assert read_parts(save("wall", "inlet")).notes[0].startswith("its 2 parts are taken together")


def _pieces(whole: trimesh.Trimesh, order: np.ndarray | None = None) -> list[Triangles]:
    faces = np.asarray(whole.faces, dtype=np.int64)
    return pieces(Triangles(np.asarray(whole.vertices), faces if order is None else faces[order]))


def test_pieces_are_parts_and_walls_are_not(vessels: dict[str, trimesh.Trimesh]):
    assert len(_pieces(trimesh.util.concatenate(list(vessels.values())))) == 4
    outer, inner = (trimesh.creation.cylinder(radius, length) for radius, length in ((12.0, 100.0), (10.0, 99.0)))
    assert len(_pieces(trimesh.util.concatenate([outer, inner]))) == 1
    # parts that share a face are apart, unless no part comes after the other
    boxes = [trimesh.creation.box((10.0, 10.0, 40.0)).apply_translation((10.0 * k, 0.0, 0.0)) for k in range(3)]
    whole = trimesh.util.concatenate(boxes)
    assert [len(piece.faces) for piece in _pieces(whole)] == [12, 12, 12]
    assert len(_pieces(whole, np.random.default_rng(0).permutation(len(whole.faces)))) == 1


def test_vessels_that_touch_without_overlapping_are_united_and_a_vein_beside_them_is_left_out(
    tmp_path: Path,
):
    """Surfaces of a segmentation's labels in one file: each closed, with a face in common with its parent.

    The aorta goes on into iliac arteries that are narrower than the left subclavian artery.
    """
    tree = arch_tree(0.03)
    grid = build_lumen(tree, resolution=1.5e-3, fillet_radius=2e-3)
    inside = grid.dense() > 0
    nodes = grid.coordinates(np.argwhere(inside))
    _, along, away = nearest_on_branch(tree.root, nodes)
    nearest = np.argmin([nearest_on_branch(tree[name], nodes)[2] for name in ("bca", "lcca", "lsa")], axis=0)
    number = np.full(inside.shape, -1)
    number[inside] = np.where(away < tree.root.radius_at(along), 0, 1 + nearest)
    made = []
    for k in range(4):
        soft = gaussian_filter((number == k).astype(np.float32), 0.8)
        vertices, faces, _, _ = marching_cubes(soft, 0.5)
        made.append(trimesh.Trimesh(1e3 * (vertices * grid.spacing + grid.origin), faces, process=False))
    for side in (-1.0, 1.0):
        way = np.linspace(0, 1, 61)[:, None] * np.array([side * 0.015, 0.0, -0.06])
        made.append(_tube(tree.root.points[0] + [side * 0.003, 0.0, 0.008] + way, np.full(61, 4.6e-3)))
    vein = trimesh.creation.capsule(90.0, 5.0).apply_translation([0.0, 30.0, -40.0])
    trimesh.util.concatenate([*made, vein]).export(tmp_path / "labels.stl")
    found = import_anatomy(tmp_path / "labels.stl", resolution=COARSE, cache_dir=tmp_path / "cache")
    # the aorta goes on into one of the two, which are alike
    assert set(found.tree.names) - {"iliac_left", "iliac_right"} == {"aorta", "bca", "lcca", "lsa"}
    assert len(found.tree.names) == 5
    report = found.imported
    assert "united from 7 parts" in report.notes
    assert "1 parts left out, which touch no other: unnamed" in report.notes
    assert check_lumen(found) == []
    assert found.tree.root.length > tree.root.length + 0.042  # seven tenths of theirs, m
    for name in ("bca", "lcca", "lsa"):
        place = (found.targets[name].position - np.array(report.offset)) @ np.array(report.rotation)
        assert nearest_on_branch(tree[name], place)[2][0] < 1.5e-3, name


def _rod(radius: float, length: float) -> trimesh.Trimesh:
    """A closed cylinder about the origin, along z, of edges of 2 mm at most."""
    heights = np.linspace(-length / 2, length / 2, round(length / 1.9e-3) + 1)
    profile = [(0.0, heights[0]), *((radius, height) for height in heights), (0.0, heights[-1])]
    return trimesh.creation.revolve(np.array(profile), sections=32).subdivide_to_size(2e-3)


def test_a_long_narrow_part_is_kept_and_one_without_a_lumen_named():
    meshes = {
        "aorta": _rod(0.01, 0.1),
        "iliac_left": _rod(1.6e-3, 0.2).apply_translation([0.0, 0.0, 0.1]),
        "lsa": trimesh.creation.box([0.02, 0.02, 0.0]).subdivide_to_size(2e-3),
    }
    parts = [Part(name, Triangles(np.asarray(mesh.vertices), np.asarray(mesh.faces))) for name, mesh in meshes.items()]
    surface, _, notes = unite(parts, 1e-3, Budget())
    assert notes == ("united from 2 parts", "1 parts left out, which enclose no lumen: lsa")
    assert surface.extent > 0.24


def test_an_aorta_that_is_torn_is_refused():
    tubes = [trimesh.creation.capsule(0.09, 0.01).apply_translation([0.0, y, 0.0]) for y in (0.0, 0.08)]
    parts = [Part("", Triangles(np.asarray(m.vertices), np.asarray(m.faces, dtype=np.int64))) for m in tubes]
    with pytest.raises(MeshRefusedError, match="falls into 2 parts"):
        unite(parts, 2e-3, Budget())


def test_a_folder_without_surfaces_or_without_an_aorta_is_refused(vessels: dict[str, trimesh.Trimesh], tmp_path: Path):
    with pytest.raises(MeshRefusedError, match="holds no file of a kind that is read"):
        import_anatomy(tmp_path)
    vessels["bca"].export(tmp_path / "bca.stl")
    vessels["lsa"].export(tmp_path / "lsa.stl")
    with pytest.raises(MeshRefusedError, match="none of them an aorta's"):
        import_anatomy(tmp_path)
