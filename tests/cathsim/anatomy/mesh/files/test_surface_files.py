"""STL of wrong counts, references of scenes and materials, scenes too large, and what is no regular file."""

import json
import os
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cathsim.anatomy import import_anatomy
from cathsim.anatomy.importing import import_digest
from cathsim.anatomy.mesh.parts import vessel_parts
from cathsim.anatomy.mesh.parts.vessel_parts import read_parts, surface_files
from cathsim.anatomy.mesh.reading import read_surfaces
from cathsim.anatomy.mesh.report import MeshRefusedError

SPHERE = trimesh.creation.icosphere(2, 10.0)
CORNERS = SPHERE.triangles
COUNT = len(CORNERS)


def _stl(count: int, behind: bytes = b"", *, of: int = COUNT, comment: bytes = b"Exported from Blender") -> bytes:
    triangles = b"".join(struct.pack("<12fH", 0, 0, 0, *corners.ravel(), 0) for corners in CORNERS[:of])
    return comment.ljust(80, b"\0") + struct.pack("<I", count) + triangles + behind


@pytest.mark.parametrize(
    ("content", "note"),
    [
        (_stl(COUNT), ""),
        (_stl(COUNT, comment=b"solid of a program that begins binary files so"), ""),
        (_stl(COUNT, bytes(4)), "4 bytes behind"),
        (_stl(COUNT, bytes(170)), "170 bytes behind"),
        (_stl(COUNT - 1), f"promises {COUNT - 1} triangles, it holds {COUNT}"),
        (_stl(2**32 - 1), f"promises 4294967295 triangles, it holds {COUNT}"),
        (_stl(0), f"promises 0 triangles, it holds {COUNT}"),
    ],
)
def test_an_stl_with_a_wrong_length_or_count_is_read_with_a_note(content: bytes, note: str, tmp_path: Path):
    (tmp_path / "a.stl").write_bytes(content)
    surface = read_parts(tmp_path / "a.stl")
    assert surface.faces == COUNT
    assert [note in one for one in surface.notes] == [True] * bool(note)


def test_an_stl_that_is_cut_off_is_refused(tmp_path: Path):
    path = tmp_path / "a.stl"
    path.write_bytes(_stl(COUNT)[:-7])
    with pytest.raises(MeshRefusedError, match=f"cut off: it promises {COUNT} triangles and holds {COUNT - 1}; export"):
        read_parts(path)
    text = SPHERE.export(file_type="stl_ascii")
    path.write_text(text)
    assert read_parts(path).faces == COUNT
    for damaged in (text[: len(text) // 2], text.replace("vertex ", "vertex 1,5 ", 1)):
        path.write_text(damaged)
        with pytest.raises(MeshRefusedError, match=r"cut off or damaged|something else than numbers"):
            read_parts(path)


def test_the_note_of_a_file_reaches_the_import(tmp_path: Path):
    from tests.cathsim.anatomy.generator.drawn_arch import arch_mesh

    path = tmp_path / "arch.stl"
    arch_mesh(0.03).export(path)
    path.write_bytes(b"3D Slicer output. SPACE=RAS".ljust(80) + path.read_bytes()[80:] + b"\n\n\n")
    report = import_anatomy(path, unit="m", resolution=2.5e-3, cache_dir=tmp_path).imported
    assert any("3 bytes behind" in note for note in report.notes)
    np.testing.assert_array_equal(report.rotation, np.diag([-1.0, -1.0, 1.0]))


@pytest.mark.parametrize("suffix", [".stl", ".glb"])
def test_a_pipe_is_refused_at_once(suffix: str, tmp_path: Path):
    path = tmp_path / f"pipe{suffix}"
    os.mkfifo(path)
    (tmp_path / "aorta.stl").write_bytes(_stl(COUNT))
    for read, what in ((read_parts, path), (import_anatomy, path), (import_anatomy, tmp_path)):
        with pytest.raises(MeshRefusedError, match=f"pipe{suffix} is no regular file"):
            read(what)


def test_materials_are_no_part_of_a_surface_and_not_opened(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe.mtl")
    path = tmp_path / "a.obj"
    for reference in ("pipe.mtl", "../secret.mtl", "C:\\me\\a.mtl"):
        path.write_text(f"mtllib {reference}\nusemtl a\n" + SPHERE.export(file_type="obj", include_normals=False))
        assert read_parts(path).faces == COUNT
        assert surface_files(path) == [path]


@pytest.mark.parametrize("kind", ["ply", "gltf"])
def test_textures_are_not_opened(kind: str, tmp_path: Path):
    path = tmp_path / f"model.{kind}"
    if kind == "ply":
        content = SPHERE.export(file_type="ply", encoding="ascii")
        path.write_bytes(content.replace(b"element vertex", b"comment TextureFile pipe.png\nelement vertex", 1))
    else:
        _gltf(tmp_path)
        tree = json.loads(path.read_text())
        tree |= {"images": [{"uri": "pipe.png"}], "textures": [{"source": 0}]}
        tree["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
        tree["meshes"][0]["primitives"][0]["material"] = 0
        path.write_text(json.dumps(tree))
    os.mkfifo(tmp_path / "pipe.png")
    surface = read_parts(path)
    assert (surface.faces, surface.notes) == (COUNT, ())


def _gltf(folder: Path) -> tuple[Path, Path]:
    folder.mkdir(exist_ok=True)
    for name, content in trimesh.Scene(SPHERE).export(file_type="gltf", merge_buffers=True).items():
        (folder / name).write_bytes(content)
    (data,) = folder.glob("*.bin")
    return folder / "model.gltf", data


def test_the_data_of_a_scene_is_part_of_its_hash(tmp_path: Path):
    path, data = _gltf(tmp_path)
    assert read_parts(path).faces == COUNT
    assert surface_files(path) == [path, data]
    before = import_digest({"path": path}, 1e-3)
    data.write_bytes(data.read_bytes()[:-4] + b"\0\0\0\0")
    assert import_digest({"path": path}, 1e-3) != before


def test_the_data_of_a_scene_stays_in_its_folder(tmp_path: Path):
    path, data = _gltf(tmp_path / "scene")
    text, outside = path.read_text(), tmp_path / "outside.bin"
    data.rename(outside)
    for name in ("../outside.bin", "%2e%2e/outside.bin", data.name):
        (data.parent / data.name).unlink(missing_ok=True)
        (data.parent / data.name).symlink_to(outside)
        path.write_text(text.replace(data.name, name))
        with pytest.raises(MeshRefusedError, match=r"model\.gltf refers to .* no file of its own folder; put the file"):
            import_anatomy(path)
    data.unlink()
    os.mkfifo(data)
    with pytest.raises(MeshRefusedError, match=r"\.bin is no regular file"):
        import_anatomy(path)


def test_a_scene_of_too_many_nodes_or_triangles_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path, _ = _gltf(tmp_path)
    tree = json.loads(path.read_text())
    mesh = next(node for node in tree["nodes"] if "mesh" in node)
    tree["nodes"] = [mesh] * 20_000
    tree["scenes"] = [{"nodes": list(range(20_000))}]
    path.write_text(json.dumps(tree))
    with pytest.raises(MeshRefusedError, match="has 20000 nodes, at most 5000 are read"):
        read_parts(path)
    tree["nodes"], tree["scenes"] = [mesh] * 100, [{"nodes": list(range(100))}]
    path.write_text(json.dumps(tree))
    monkeypatch.setattr("cathsim.anatomy.mesh.files.scenes.MOST_TRIANGLES", 100 * COUNT - 1)
    with pytest.raises(MeshRefusedError, match=f"has {100 * COUNT} triangles in 100 nodes, at most"):
        read_parts(path)
    tree["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    path.write_text(json.dumps(tree))
    with pytest.raises(MeshRefusedError, match=r"is compressed \(KHR_draco_mesh_compression\); export it without"):
        read_parts(path)


def test_files_in_different_frames_are_not_mixed(tmp_path: Path):
    for name, space in (("aorta.stl", b"SPACE=LPS"), ("lcca.stl", b"SPACE=RAS")):
        (tmp_path / name).write_bytes(_stl(COUNT, comment=space))
    with pytest.raises(MeshRefusedError, match="have coordinates in LPS, others in RAS"):
        read_parts(tmp_path)


def _crashing(path: Path) -> None:
    os.abort()


def test_a_reader_that_crashes_is_a_refusal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "a.stl").write_bytes(_stl(COUNT))
    monkeypatch.setattr(vessel_parts, "_read_parts", _crashing)
    with pytest.raises(MeshRefusedError, match=r"a\.stl cannot be read: its reader crashed \(SIGABRT\)"):
        read_parts(tmp_path / "a.stl")


def test_a_binary_ply_of_triangles_and_quadrilaterals_is_read(tmp_path: Path):
    content = Path(__file__).with_name("blender.ply").read_bytes()  # by Blender 4.2: a sphere of radius 10, 42 points
    path = tmp_path / "a.ply"
    path.write_bytes(content)
    (part,) = read_parts(path).parts
    assert len(part.mesh.faces) == 80
    np.testing.assert_allclose(np.linalg.norm(part.mesh.vertices, axis=1), 10.0, atol=1e-5)
    big = content.replace(b"little", b"big")
    head = big.index(b"end_header\n") + len(b"end_header\n")
    path.write_bytes(big[:head] + _in_other_order(big[head:], points=42))
    assert np.array_equal(read_parts(path).parts[0].mesh.corners, part.mesh.corners)
    for damaged in (content[:-3], content.replace(b"element face 48", b"element face 99")):
        path.write_bytes(damaged)
        with pytest.raises(MeshRefusedError, match="expected a triangle mesh in PLY format"):
            read_parts(path)


def _in_other_order(data: bytes, points: int) -> bytes:
    swapped, at = np.frombuffer(data[: 12 * points], "<f4").byteswap().tobytes(), 12 * points
    while at < len(data):
        end = at + 1 + 4 * data[at]
        swapped += data[at : at + 1] + np.frombuffer(data[at + 1 : end], "<i4").byteswap().tobytes()
        at = end
    return swapped


@pytest.mark.parametrize("kind", ["off", "ply", "binary ply"])
@pytest.mark.parametrize(("faces", "answer"), [(5, "refused"), (-5, "noted"), (-COUNT // 2, "refused")])
def test_a_head_that_promises_other_faces_than_there_are(kind: str, faces: int, answer: str, tmp_path: Path):
    content = SPHERE.export(file_type=kind[-3:], **({"encoding": "ascii"} if kind == "ply" else {}))
    content = content.encode() if isinstance(content, str) else content
    path = tmp_path / f"a.{kind[-3:]}"
    path.write_bytes(content)
    assert (read_parts(path).faces, read_parts(path).notes) == (COUNT, ())
    before, after = (
        f"{len(SPHERE.vertices)} {n} 0" if kind == "off" else f"face {n}\n" for n in (COUNT, COUNT + faces)
    )
    path.write_bytes(content.replace(before.encode(), after.encode(), 1))
    if answer == "refused":
        with pytest.raises(MeshRefusedError, match=r"it promises|expected a triangle mesh in PLY"):
            read_parts(path)
        return
    surface = read_parts(path)
    assert surface.faces == COUNT + faces
    assert surface.notes[0].endswith("are left out")


@pytest.mark.parametrize("suffix", [".stl", ".ply"])
def test_points_that_are_no_numbers(suffix: str, tmp_path: Path):
    points = np.array(SPHERE.vertices)
    points[0] = np.nan
    trimesh.Trimesh(points, SPHERE.faces, process=False).export(tmp_path / f"a{suffix}")
    (note,) = read_parts(tmp_path / f"a{suffix}").notes
    assert note.startswith(f"5 of its {COUNT} faces lack finite coordinates")
    points[: len(points) // 5] = np.nan
    trimesh.Trimesh(points, SPHERE.faces, process=False).export(tmp_path / f"a{suffix}")
    with pytest.raises(MeshRefusedError, match="holds no surface with finite coordinates"):
        read_parts(tmp_path / f"a{suffix}")


@pytest.mark.parametrize("change", ["fan", "sparse", "points"])
def test_a_scene_of_other_things_than_plain_triangles(change: str, tmp_path: Path):
    path, _ = _gltf(tmp_path)
    tree = json.loads(path.read_text())
    (part,) = tree["meshes"][0]["primitives"]
    if change == "points":
        tree["meshes"].append({"primitives": [{"attributes": {"POSITION": part["attributes"]["POSITION"]}, "mode": 0}]})
        tree["nodes"].append({"mesh": 1, "name": "landmarks"})
        tree["scenes"][0]["nodes"].append(len(tree["nodes"]) - 1)
        path.write_text(json.dumps(tree))
        assert read_parts(path).notes == ("1 nodes without triangles are left out: landmarks",)
        return
    part["mode"] = 6 if change == "fan" else 4
    if change == "sparse":
        tree["accessors"][part["attributes"]["POSITION"]]["sparse"] = {"count": 1}
    path.write_text(json.dumps(tree))
    with pytest.raises(MeshRefusedError, match="fans of triangles, or sparse or normalized numbers"):
        read_parts(path)


def test_a_node_of_several_primitives_is_one_part_by_its_own_name(tmp_path: Path):
    path, _ = _gltf(tmp_path)
    tree = json.loads(path.read_text())
    (part,) = tree["meshes"][0]["primitives"]
    points = {"attributes": {"POSITION": part["attributes"]["POSITION"]}}
    tree["meshes"] = [{"primitives": [part, part | {"material": 0}, points | {"mode": 0}]}, {"primitives": [part]}]
    tree["meshes"].append({"primitives": [part, points | {"mode": 3}]})  # of a line, which trimesh leaves out
    tree["materials"] = [{}]
    tree["nodes"] = [
        {"name": "world", "children": [1, 2, 3, 4]},
        {"name": "aorta", "mesh": 0, "translation": [50, 0, 0]},
        {"name": "lsa", "mesh": 0, "scale": [2, 2, 2]},
        {"name": "lsa", "mesh": 1},
        {"name": "lcca", "mesh": 2},
    ]
    tree["scenes"], tree["scene"] = [{"nodes": [0]}], 0
    path.write_text(json.dumps(tree))
    found = {surface.name: surface for surface in read_surfaces(path)}
    assert {name: len(surface.mesh.faces) for name, surface in found.items()} == {
        "aorta": 2 * COUNT, "lsa": 2 * COUNT, "lsa_1": COUNT, "lcca": COUNT
    }  # fmt: skip
    assert found["aorta"].notes == ()
    np.testing.assert_allclose(found["aorta"].mesh.bounds, SPHERE.bounds + np.array([50, 0, 0]), atol=1e-5)
    np.testing.assert_allclose(found["lsa"].mesh.bounds, 2 * SPHERE.bounds, atol=1e-5)
    assert sorted(part.name for part in read_parts(path).parts) == ["aorta", "lcca", "lsa", "lsa"]
