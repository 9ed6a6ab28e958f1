"""Anatomies in parts: one file a vessel, nodes of a scene, pieces of one file become one lumen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from cathsim.anatomy import Branch, MeshRefusedError, VesselTree, import_mesh
from cathsim.anatomy.lumen import build_lumen
from cathsim.anatomy.lumen_report import check_lumen
from cathsim.anatomy.mesh.parts.vessel_parts import is_folder_of_parts, pieces, read_parts
from cathsim.anatomy.mesh.reading import Triangles
from cathsim.anatomy.surface import lumen_surface
from tests.cathsim.anatomy.generator.drawn_arch import arch_tree

COARSE = 2e-3
FILES = {"aorta": "aorta.stl", "bca": "brachiocephalic_trunk.stl", "lcca": "left_common_carotid.obj", "lsa": "LSA.ply"}


@pytest.fixture(scope="module")
def vessels() -> dict[str, trimesh.Trimesh]:
    """Closed tubes in millimetres; the branches begin within the aorta."""
    tree = arch_tree(0.03)
    made = {}
    for branch in tree:
        whole = Branch(branch.name, branch.points, branch.radius)
        made[branch.name] = lumen_surface(build_lumen(VesselTree((whole,)), resolution=1e-3, fillet_radius=2e-3))
        made[branch.name].apply_scale(1000)
    return made


def test_a_folder_with_a_file_a_vessel(vessels: dict[str, trimesh.Trimesh], tmp_path: Path):
    folder = tmp_path / "patient"
    folder.mkdir()
    for name, file in FILES.items():
        vessels[name].export(folder / file)
    vessels["lsa"].copy().apply_translation([200, 0, 0]).export(folder / "left_brachiocephalic_vein.stl")
    assert is_folder_of_parts(folder)
    assert not is_folder_of_parts(tmp_path)
    found = import_mesh(folder, resolution=COARSE, cache_dir=tmp_path / "cache")
    assert set(found.tree.names) == {"aorta", "bca", "lcca", "lsa"}
    assert check_lumen(found).problems == ()
    report = found.imported
    assert report is not None
    assert any(note.startswith("1 of 5 parts left out") for note in report.notes)
    assert "united from 4 parts" in report.notes
    assert found.tree["bca"].parent_arc > found.tree["lsa"].parent_arc
    drawn = arch_tree(0.03)
    assert float(np.median(found.tree.root.radius)) == pytest.approx(float(np.median(drawn.root.radius)), rel=0.03)
    assert float(found.tree["lcca"].radius[-5]) == pytest.approx(4.0e-3, rel=0.06)


def test_a_scene_names_its_parts(vessels: dict[str, trimesh.Trimesh], tmp_path: Path):
    scene = trimesh.Scene()
    for name, mesh in vessels.items():
        scene.add_geometry(mesh, node_name=f"VHM_{FILES[name].split('.')[0]}", geom_name=name)
    scene.add_geometry(trimesh.creation.icosphere(2, 20.0), node_name="VHM_left_renal_vein", geom_name="vein")
    path = tmp_path / "scene.glb"
    scene.export(path)
    parts, faces, notes = read_parts(path)
    assert sorted(part.name for part in parts) == ["aorta", "bca", "lcca", "lsa"]
    assert faces == sum(len(mesh.faces) for mesh in scene.geometry.values())
    assert notes[0].startswith("1 of 5 parts left out")


def test_pieces_are_parts_and_walls_are_not(vessels: dict[str, trimesh.Trimesh]):
    whole = trimesh.util.concatenate(list(vessels.values()))
    triangles = Triangles(np.asarray(whole.vertices), np.asarray(whole.faces, dtype=np.int64))
    assert len(pieces(triangles)) == 4
    outer, inner = (trimesh.creation.cylinder(radius, length) for radius, length in ((12.0, 100.0), (10.0, 99.0)))
    wall = trimesh.util.concatenate([outer, inner])
    assert len(pieces(Triangles(np.asarray(wall.vertices), np.asarray(wall.faces, dtype=np.int64)))) == 1


def test_a_folder_without_surfaces_or_without_an_aorta_is_refused(vessels: dict[str, trimesh.Trimesh], tmp_path: Path):
    with pytest.raises(MeshRefusedError, match="holds no surface"):
        import_mesh(tmp_path)
    vessels["bca"].export(tmp_path / "bca.stl")
    vessels["lsa"].export(tmp_path / "lsa.stl")
    with pytest.raises(MeshRefusedError, match="none of them an aorta's"):
        import_mesh(tmp_path)
