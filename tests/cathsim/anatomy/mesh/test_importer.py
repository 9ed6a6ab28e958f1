"""Meshes of the project's own phantoms come back as phantoms, however disguised; what cannot work is refused."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cathsim.anatomy import ImportReport, MeshRefusedError, Phantom, import_anatomy, importing, load_phantom
from cathsim.anatomy.library import phantom_from_spec, phantom_to_spec
from cathsim.anatomy.mesh.reading import Triangles, clean_triangles
from cathsim.anatomy.mesh.samples import sample_surface
from cathsim.anatomy.surface import _cut, open_ends
from cathsim.anatomy.vessel_tree import nearest_on_branch
from tests.cathsim.anatomy.lumen_report import check_lumen

COARSE = 2e-3
REAL = Path(__file__).resolve().parents[5] / "shared" / "real" / "phantoms" / "low_tortuosity.stl"
BRANCHES = {"aorta", "bca", "rsa", "rcca", "lcca", "lsa"}
SHIFT = np.array([0.01, 0.02, 0.03])


@dataclasses.dataclass
class Disguise:
    """How a phantom's mesh is made hard to recognise."""

    unit: str = "mm"
    wall: bool = False
    opened: bool = False
    inverted: bool = False
    holes: bool = False
    repeated: bool = False
    rotation: np.ndarray = dataclasses.field(default_factory=lambda: np.eye(3))

    @property
    def scale(self) -> float:
        return {"m": 1.0, "cm": 100.0, "mm": 1000.0, "inch": 1 / 0.0254}[self.unit]

    def write(self, phantom: Phantom, path: Path) -> Path:
        mesh = phantom.wall_mesh(3e-3) if self.wall else phantom.lumen_mesh.copy()
        if self.opened:
            for centre, normal, radius in open_ends(phantom.tree):
                mesh = _cut(mesh, centre - 1.5e-3 * normal, normal, radius + 4e-3)
        if self.holes:
            middle = mesh.triangles_center
            chosen = middle[np.random.default_rng(0).integers(len(middle), size=10)]
            near = np.linalg.norm(middle[:, None] - chosen, axis=2).min(axis=1) < 1.5e-3
            mesh.update_faces(~near)
        faces = mesh.faces[:, ::-1] if self.inverted else mesh.faces
        if self.repeated:
            faces = np.concatenate([faces, faces[:500], faces[:100, [0, 0, 1]]])
        trimesh.Trimesh(self.to_file(mesh.vertices), faces, process=False).export(path)
        return path

    def to_file(self, points: np.ndarray) -> np.ndarray:
        return (points @ self.rotation.T + SHIFT) * self.scale

    def from_world(self, points: np.ndarray, report: ImportReport) -> np.ndarray:
        """Points of the imported phantom's frame in that of the original."""
        in_file = (points - np.array(report.offset)) @ np.array(report.rotation) / report.scale
        return (in_file / self.scale - SHIFT) @ self.rotation


DISGUISES = {
    "thick-walled, in centimetres, with repeated faces": Disguise(unit="cm", wall=True, repeated=True),
    "open, inverted, in inches, with holes, turned": Disguise(
        unit="inch",
        opened=True,
        inverted=True,
        holes=True,
        rotation=trimesh.transformations.rotation_matrix(1.9, [0.5, 0.3, -0.8])[:3, :3],
    ),
}


@pytest.fixture(scope="module")
def thick(phantom: Phantom, cache: Path) -> tuple[Path, Phantom]:
    path = next(iter(DISGUISES.values())).write(phantom, cache / "arch_0.stl")
    return path, import_anatomy(path, resolution=COARSE, cache_dir=cache)


@pytest.mark.parametrize("number", range(len(DISGUISES)), ids=list(DISGUISES))
def test_a_disguised_phantom_comes_back(number: int, phantom: Phantom, cache: Path):
    disguise = list(DISGUISES.values())[number]
    path = disguise.write(phantom, cache / f"arch_{number}.stl")
    unit = "inch" if disguise.unit == "inch" else None
    found = import_anatomy(path, unit=unit, resolution=COARSE, cache_dir=cache)
    report = found.imported
    assert report.unit == disguise.unit
    # as small in centimetres as a child's: an inch must be given
    assert report.unit_reason.startswith("given" if disguise.unit == "inch" else "detected: its widest vessel is then ")
    assert set(found.tree.names) == BRANCHES
    assert found.tree["rcca"].parent == found.tree["rsa"].parent == "bca"
    assert report.axes_kept == np.array_equal(disguise.rotation, np.eye(3))
    assert set(found.entries) == {"descending", "ascending"}
    for name in ("bca", "lcca", "lsa", "rcca", "rsa"):
        here = disguise.from_world(found.targets[name].position, report)
        assert np.linalg.norm(here - phantom.targets[name].position) < 3e-3, name
        branch = found.tree[name]
        arcs = np.linspace(found.targets[name].arc - 5e-3, found.targets[name].arc + 3e-3, 9)
        _, same, aside = nearest_on_branch(phantom.tree[name], disguise.from_world(branch.point_at(arcs), report))
        assert aside.max() < 1e-3, name
        assert np.abs(branch.radius_at(arcs) - phantom.tree[name].radius_at(same)).max() < 5e-4, name
    arcs = np.linspace(0.02, found.tree.root.length - 0.02, 60)
    points = disguise.from_world(found.tree.root.point_at(arcs), report)
    _, same, aside = nearest_on_branch(phantom.tree.root, points)
    assert aside.max() < 1.5e-3
    assert np.abs(found.tree.root.radius_at(arcs) - phantom.tree.root.radius_at(same)).max() < 5e-4
    # its distance grid is the lumen's
    points = np.random.default_rng(1).uniform(*found.grid.bounds, size=(20_000, 3))
    same = disguise.from_world(points, report)
    here, original = found.grid.sample(points), phantom.grid.sample(same)
    away = np.ones(len(points), dtype=bool)
    for centre, _, radius in open_ends(phantom.tree):  # vessels are cut a little before they end
        away &= np.linalg.norm(same - centre, axis=1) > 1.5 * radius + 6e-3
    near = away & (np.abs(original) < 2e-3)
    assert near.sum() > 100
    assert np.abs(here - original)[near].max() < (1.2e-3 if disguise.holes else 8e-4)
    assert np.median(np.abs(here - original)[near]) < 1.5e-4
    assert check_lumen(found) == []
    # its pose is near the patient's
    rotation = np.array(report.rotation)
    angle = np.degrees(np.arccos(np.clip((np.trace(rotation @ disguise.rotation) - 1) / 2, -1, 1)))
    assert angle < (1e-3 if report.axes_kept else 12.0)
    assert np.isclose(np.linalg.det(rotation), 1.0)
    assert found.targets["lsa"].position[0] > found.targets["lcca"].position[0] > found.targets["bca"].position[0]
    assert found.entry().direction[2] > 0.9
    assert np.abs(found.bounds.mean(axis=0)).max() < 5e-3


def test_it_can_be_described_and_a_changed_file_is_refused(thick: tuple[Path, Phantom], tmp_path: Path):
    path, found = thick
    description = json.loads(json.dumps(phantom_to_spec(found)))
    assert phantom_from_spec(description).hash == found.hash
    moved = tmp_path / "arch_0.stl"
    moved.write_bytes(path.read_bytes()[:-1] + b"\x01")
    description["mesh"]["path"] = str(moved)
    with pytest.raises(ValueError, match="phantom 'arch_0' is another than the one described"):
        phantom_from_spec(description)


def test_it_is_cached_with_its_report(thick: tuple[Path, Phantom], cache: Path, monkeypatch: pytest.MonkeyPatch):
    path, found = thick
    assert import_anatomy(path, resolution=COARSE, cache_dir=cache) is found
    assert load_phantom(path, resolution=COARSE, cache_dir=cache, unit=None) is found
    importing._load.cache_clear()
    monkeypatch.setattr(importing, "build_surface_phantom", None)  # building again would fail
    again = import_anatomy(path, resolution=COARSE, cache_dir=cache)
    assert again is not found
    assert again.imported == found.imported
    assert again.hash == found.hash
    assert np.array_equal(again.grid.values, found.grid.values)
    assert again.parameters is None
    with pytest.raises(ValueError, match="a phantom from a file takes no seed, got 3"):
        load_phantom(str(path), seed=3)


@pytest.mark.skipif(not REAL.is_file(), reason="../shared/real is not there")
def test_a_real_thick_walled_mesh(tmp_path: Path):
    found = import_anatomy(REAL, resolution=COARSE, cache_dir=tmp_path)
    assert found.imported.unit == "m"
    assert found.imported.kind == "tunnel"
    assert {"aorta", "bca", "lcca", "lsa"} == set(found.tree.names)
    assert {"bca", "lcca", "lsa"} <= set(found.targets)
    assert found.targets["lcca"].position[0] > found.targets["bca"].position[0] + 0.02


REFUSED = {
    "cube": (trimesh.creation.box((80, 80, 80)), None, "in no unit is this an aorta"),
    "tube": (trimesh.creation.cylinder(12, 110), "mm", "the lumen has 2 ends"),
    "spheres": (
        trimesh.creation.icosphere(3, 15.0) + trimesh.creation.icosphere(3, 15.0).apply_translation([60, 0, 0]),
        None,
        r"falls into 2 parts that do not hang together \(30 x 30 x 30, 30 x 30 x 30 mm\)",
    ),
    "wire": (trimesh.creation.cylinder(0.5, 80), "mm", "the lumen is too narrow for a wire"),
    "huge": (trimesh.creation.cylinder(120, 2500), "mm", "this surface is too large"),
}


@pytest.mark.parametrize("name", list(REFUSED))
def test_what_cannot_work_is_refused_with_a_picture(name: str, tmp_path: Path):
    mesh, unit, reason = REFUSED[name]
    path = tmp_path / f"{name}.stl"
    mesh.export(path)
    with pytest.raises(MeshRefusedError, match=reason) as refusal:
        import_anatomy(path, unit=unit, resolution=COARSE, cache_dir=tmp_path)
    picture = refusal.value.picture
    if picture is not None:  # needs matplotlib, an extra
        assert picture.read_bytes().startswith(b"\x89PNG")
        assert str(picture) in str(refusal.value)


def test_what_is_no_mesh_is_refused(tmp_path: Path):
    for name, content, message in (
        ("empty.stl", b"", "empty.stl is empty"),
        ("text.stl", b"no mesh at all\n" * 20, "text.stl cannot be read as a mesh"),
        ("text.ply", b"no mesh", "text.ply cannot be read as a mesh: expected a triangle mesh in PLY format"),
        ("text.obj", b"no mesh\n", "text.obj holds no surface"),
        ("notes.txt", b"no mesh", r"notes.txt is no file of a kind that is read"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(MeshRefusedError, match=message) as refusal:
            import_anatomy(tmp_path / name, cache_dir=tmp_path)
        assert refusal.value.picture is None


def test_wrong_arguments(tmp_path: Path):
    with pytest.raises(MeshRefusedError, match=r"there is no file .*none\.stl"):
        import_anatomy(tmp_path / "none.stl")
    with pytest.raises(MeshRefusedError, match="unknown unit 'foot'; choose from m, cm, mm, inch"):
        import_anatomy(tmp_path / "none.stl", unit="foot")
    with pytest.raises(ValueError, match=r"resolution must lie in \[0.0005, 0.0025\] m for a mesh, got 0.01"):
        import_anatomy(tmp_path / "none.stl", resolution=0.01)


def test_too_many_faces_are_thinned_out(phantom: Phantom):
    mesh = phantom.lumen_mesh.subdivide()
    fine = Triangles(np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int64))
    thin, notes = clean_triangles(fine, most_faces=50_000)
    assert len(fine.faces) > 200_000
    assert len(thin.faces) < 0.75 * len(fine.faces)
    assert any("thinned out to" in note for note in notes)
    volume = trimesh.Trimesh(thin.vertices, thin.faces, process=False).volume
    assert volume == pytest.approx(mesh.volume, rel=0.005)
    away, _ = sample_surface(thin.corners, 5e-4).tree.query(mesh.vertices[::50])
    assert away.max() < 1e-3
