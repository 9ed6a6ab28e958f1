"""Damaged meshes: each is imported as it was meant, or refused in one sentence within the budget of an import."""

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cathsim.anatomy import MeshRefusedError, Phantom, import_anatomy
from cathsim.anatomy.mesh.lattice import Budget, lattice_spacing
from cathsim.anatomy.mesh.openings import close_openings
from cathsim.anatomy.mesh.reading import Size, Triangles, detect_unit
from cathsim.anatomy.mesh.samples import sample_surface
from cathsim.anatomy.mesh.surface_import import SurfaceFacts, SurfaceImport
from tests.cathsim.anatomy.generator.drawn_arch import arch_mesh

COARSE = 2e-3
WHOLE = ("aorta", "bca", "lcca", "lsa")
Surface = tuple[np.ndarray, np.ndarray]


@pytest.fixture(scope="module")
def surface() -> Surface:
    """Vertices (mm) and faces of a closed arch of about 40,000 triangles."""
    mesh = arch_mesh(0.03, cut_open=False)
    return np.asarray(mesh.vertices) * 1e3, np.asarray(mesh.faces)


def imported(surface: Surface, folder: Path, unit: str | None = None) -> Phantom:
    path = folder / "damaged.ply"
    trimesh.Trimesh(*surface, process=False).export(path)
    return import_anatomy(path, unit=unit, resolution=COARSE, cache_dir=folder)


def with_loose_triangles(surface: Surface) -> Surface:
    vertices, faces = surface
    middle, edges = vertices.mean(axis=0), faces[::20, :2]
    tips = 0.7 * vertices[edges[:, 0]] + 0.3 * middle
    loose = np.column_stack([edges, len(vertices) + np.arange(len(edges))])
    return np.concatenate([vertices, tips]), np.concatenate([faces, loose])


def with_fins(surface: Surface) -> Surface:
    vertices, faces = surface
    edges = faces[:1000, :2]
    fins = np.column_stack([edges, len(vertices) + np.arange(len(edges))])
    return np.concatenate([vertices, vertices[edges[:, 0]] + [0, 15, 0]]), np.concatenate([faces, fins])


def with_holes(share: float, surface: Surface) -> Surface:
    vertices, faces = surface
    return vertices, faces[np.random.default_rng(0).random(len(faces)) > share]


def moved(changes: dict[int, float], surface: Surface) -> Surface:
    vertices = surface[0].copy()
    for step, value in changes.items():
        vertices[::step] = value
    return vertices, surface[1]


def test_missing_triangles_are_put_back_and_fins_outside_are_no_lumen(surface: Surface, tmp_path: Path):
    vertices, faces = with_fins(surface)
    found = imported((vertices, faces[::2]), tmp_path)
    assert found.tree.names == WHOLE
    assert any(note.endswith("missing triangles put back") for note in found.imported.notes)


REFUSED = {
    "half the faces missing": (lambda s: with_holes(0.5, s), "full of holes: 50% of its edges"),
    "loose triangles inside": (with_loose_triangles, r"no wall surrounds the vessel at \d+ of|the import would take"),
    "a vertex far off": (lambda s: moved({len(s[0]): 1e30}, s), "stray vertices: most lie within 133"),
    "too large numbers": (lambda s: (s[0] * 1e30, s[1]), "in no unit is this an aorta"),
}


@pytest.mark.parametrize("damage", list(REFUSED))
def test_what_cannot_be_mended_is_refused(damage: str, surface: Surface, tmp_path: Path):
    make, reason = REFUSED[damage]
    with pytest.raises(MeshRefusedError, match=reason):
        imported(make(surface), tmp_path)


def test_a_wrong_unit_is_told_with_the_one_that_fits(surface: Surface, tmp_path: Path):
    with pytest.raises(MeshRefusedError, match=r"; mm would fit \(22\.6 mm wide\)"):
        imported(surface, tmp_path, unit="m")


def test_an_unsure_unit_is_noted():
    assert detect_unit(Size(28.0, 220.0))[0::2] == ("mm", ())
    unit, _, (note,) = detect_unit(Size(1.6, 14.0))
    assert unit == "cm"  # scans and their models come in metric units
    assert "inch could be meant" in note
    assert Size(28.0, 220.0).hint("mm") == ""
    assert "mm would fit" in Size(28.0, 220.0).hint("cm")


def test_an_import_that_takes_too_long_is_refused(surface: Surface):
    build = SurfaceImport(SurfaceFacts("slow.ply"), "slow", "slow", COARSE, budget=Budget(seconds=0.0))
    with pytest.raises(MeshRefusedError, match="has taken the 0 s of processor time it may take, before finding"):
        build.phantom(Triangles(np.asarray(surface[0]) / 1000, np.asarray(surface[1])))


def test_a_long_import_tells_its_time_and_its_steps_on_a_terminal(monkeypatch, capsys):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    budget = Budget()
    for voxels in (3e6, 40e6):
        budget.check_lattice(voxels, 7e-4, "610 x 230 x 140 mm in mm")
    budget._began -= 7.0
    budget.check_time("finding its vessels")
    assert re.search("about 48 s.*\n.* finding its vessels after 7 s", capsys.readouterr().err)


def test_a_large_surface_gets_the_voxels_that_fit_and_a_note():
    sides = np.array([0.2, 0.14, 0.5])
    assert lattice_spacing(0.03, sides, 1e-3, Budget(), "mm") == (7e-4, ())
    spacing, (note,) = lattice_spacing(0.03, 1.5 * sides, 1e-3, Budget(), "mm")
    assert np.prod(1.5 * sides) / spacing**3 < 46e6
    assert note.startswith("its voxels are 1 mm wide instead of 0.7")
    with pytest.raises(MeshRefusedError, match=r"at 2\.5 mm this surface is too large"):
        lattice_spacing(0.03, 3 * sides, 1e-3, Budget(), "mm")


def test_too_many_points_are_refused_before_they_are_made():
    corners = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    with pytest.raises(MeshRefusedError, match=r"the import would take [\de+.]+ GB, it may take 1.5"):
        sample_surface(corners, 1e-9)
    with pytest.raises(MeshRefusedError, match="the import would take"):
        sample_surface(corners, 1e-3, Budget(memory=1e6))


def test_rings_that_touch_are_closed_one_by_one():
    sphere = trimesh.creation.icosphere(3, 10.0)
    vertices, faces = np.asarray(sphere.vertices), np.asarray(sphere.faces, np.int64)
    around = (faces == 0).any(axis=1)
    neighbour = int(next(v for v in faces[around].ravel() if v != 0))
    far = next(v for v in np.unique(faces[(faces == neighbour).any(axis=1)]) if v not in faces[around])
    opened = Triangles(vertices, faces[~around & ~(faces == far).any(axis=1)])
    closed, openings, put_back = close_openings(opened)
    assert put_back == 0
    assert len(openings) >= 2
    assert np.linalg.norm(openings, axis=1).min() > 9.0  # every cone is low: none has its tip inside
    edges = np.sort(closed.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
