"""Reading a mesh: welding, closing, samples, which room is the lumen, where vessels end."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.ndimage import binary_dilation, distance_transform_edt

from cathsim.anatomy import MeshRefusedError
from cathsim.anatomy.mesh.cavity import Cavity, find_cavity
from cathsim.anatomy.mesh.ends import end_before
from cathsim.anatomy.mesh.openings import close_openings
from cathsim.anatomy.mesh.reading import Triangles, clean_triangles, read_surfaces
from cathsim.anatomy.mesh.samples import nearest_on_triangles, sample_surface


def test_faces_of_vertices_that_are_not_there_are_refused(tmp_path: Path):
    path = tmp_path / "box.ply"
    trimesh.creation.box((1, 1, 1)).export(path, encoding="ascii")
    assert len(read_surfaces(path)[0].mesh.faces) == 12
    head, _, body = path.read_text().partition("end_header\n")
    lines = body.splitlines()
    for wrong in ("3 0 1 99", "3 0 1 -2"):
        path.write_text(f"{head}end_header\n" + "\n".join([*lines[:-1], wrong]) + "\n")
        with pytest.raises(MeshRefusedError, match=r"box\.ply (has faces of vertices|cannot be read)"):
            read_surfaces(path)


def test_welding_and_closing():
    box = trimesh.creation.box((1, 1, 1))
    soup = Triangles(box.triangles.reshape(-1, 3), np.arange(36).reshape(-1, 3))  # no two faces share a vertex
    mesh, _ = clean_triangles(soup)
    assert len(mesh.vertices) == 8
    closed, openings, _ = close_openings(mesh)
    assert len(openings) == 0
    opened = Triangles(mesh.vertices, mesh.faces[2:])
    closed, openings, _ = close_openings(opened)
    assert openings.shape == (1, 3)
    assert len(closed.faces) == len(opened.faces) + 4
    edges = np.sort(closed.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()


SPACING = 1e-3  # m


def open_pipe(radius: float, length: float, aside: float) -> np.ndarray:
    """Triangles (n, 3, 3) m of a pipe's wall, parallel to z, both ends open."""
    pipe = trimesh.creation.cylinder(radius, length, sections=48)
    wall = np.abs(pipe.face_normals[:, 2]) < 0.5
    return pipe.triangles[wall] + [aside, 0.0, 0.0]


def test_a_bore_outside_of_the_surface_is_no_part_of_the_lumen():
    bore = trimesh.creation.annulus(6e-3, 8e-3, 50e-3, sections=48).apply_translation([25e-3, 0.0, 0.0])
    surface = np.concatenate([open_pipe(10e-3, 100e-3, 0.0), bore.triangles])
    for corners in (surface, surface[:, ::-1]):  # normals outwards and inwards
        cavity = find_cavity(sample_surface(corners, 0.7 * SPACING), SPACING)
        assert cavity.kind == "tunnel"
        assert cavity.holds(cavity.inside, np.zeros(3))
        assert not cavity.holds(cavity.inside, np.array([25e-3, 0.0, 0.0]))


def test_a_part_that_was_torn_off_the_lumen_is_refused():
    surface = np.concatenate([open_pipe(10e-3, 100e-3, 0.0), open_pipe(6e-3, 50e-3, 25e-3)])
    with pytest.raises(MeshRefusedError, match="falls into 2 parts that do not hang together"):
        find_cavity(sample_surface(surface, 0.7 * SPACING), SPACING)
    rough = find_cavity(sample_surface(surface, 0.7 * SPACING), SPACING, rough=True)  # only its width is wanted
    assert rough.widest == pytest.approx(10e-3, abs=1.5e-3)


def test_a_wall_beside_the_lumen_that_is_open_at_the_ends_is_no_part_of_it():
    """As models of blood and wall have it: a full pipe within a layer, which meet at one surface."""
    layer = trimesh.creation.annulus(10e-3, 15e-3, 100e-3, sections=48)
    blood = trimesh.creation.cylinder(10e-3, 100e-3, sections=48)
    surface = np.concatenate([layer.triangles, blood.triangles])
    cavity = find_cavity(sample_surface(surface, 0.5 * SPACING), 0.7 * SPACING)
    assert cavity.kind == "lumen in a closed wall"
    assert cavity.widest == pytest.approx(10e-3, abs=1e-3)
    assert cavity.holds(cavity.inside, np.zeros(3))
    assert not cavity.holds(cavity.inside, np.array([12.5e-3, 0.0, 0.0]))


ENDS_SPACING = 0.7e-3
WIDE, LENGTH = 5e-3, 0.03  # m
MIDDLE = np.array([0.01, 0.01])
BESIDE = 2e-3  # m from the wide vessel's middle to the narrow one's


def _cavity(narrow: float) -> Cavity:
    """A wide straight vessel along z from which one of another radius (m) goes on."""
    grid = np.stack(np.meshgrid(*[np.arange(30)] * 2, np.arange(100), indexing="ij"), axis=-1) * ENDS_SPACING
    across = np.linalg.norm(grid[..., :2] - MIDDLE, axis=-1)
    beside = np.linalg.norm(grid[..., :2] - MIDDLE - [BESIDE, 0.0], axis=-1)
    z = grid[..., 2]
    lumen = ((across < WIDE) & (z < LENGTH)) | ((beside < narrow) & (z < 2 * LENGTH) & (z > 0.5 * LENGTH))
    wall = binary_dilation(lumen, np.ones((3, 3, 3))) & ~lumen
    return Cavity(lumen, wall, np.zeros(3), ENDS_SPACING, "closed lumen", WIDE)


def _way(cavity: Cavity, until: float) -> tuple[np.ndarray, np.ndarray]:
    z = np.arange(2 * ENDS_SPACING, until, ENDS_SPACING)
    x = np.where(z < 0.9 * LENGTH, 0.0, BESIDE)
    points = np.stack([MIDDLE[0] + x, np.full(len(z), MIDDLE[1]), z], axis=1)
    depth = distance_transform_edt(cavity.inside) * ENDS_SPACING
    return points, depth[tuple(cavity.index(points).T)]


def test_a_wide_vessel_ends_where_a_way_goes_on_in_a_narrow_one_alone():
    cavity = _cavity(1.2e-3)
    end = end_before(cavity, *_way(cavity, 1.9 * LENGTH))
    assert abs(end.centre[2] - LENGTH) < 4 * ENDS_SPACING
    assert np.linalg.norm(end.centre[:2] - MIDDLE) < 2 * ENDS_SPACING
    assert abs(end.radius - WIDE) < 2 * ENDS_SPACING
    assert end.normal[2] > 0.95
    assert end_before(cavity, *_way(cavity, LENGTH)) is None  # a way that stops in it
    wide = _cavity(4e-3)
    assert end_before(wide, *_way(wide, 1.9 * LENGTH)) is None


def test_distances_to_triangles_are_exact():
    triangle = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    points = np.array([[0.2, 0.2, 0.5], [2.0, 0, 0], [-1, -1, 0], [1, 1, 0], [0.5, -0.3, 0.4]])
    foot = nearest_on_triangles(points, np.repeat(triangle, 5, axis=0))
    assert np.allclose(foot, [[0.2, 0.2, 0], [1, 0, 0], [0, 0, 0], [0.5, 0.5, 0], [0.5, 0, 0]])
    sphere = trimesh.creation.icosphere(4, 0.01)
    samples = sample_surface(np.asarray(sphere.triangles), 5e-4)
    rng = np.random.default_rng(0)
    inner = rng.normal(size=(200, 3))
    inner *= (0.008 / np.linalg.norm(inner, axis=1))[:, None]
    distance, place, face = samples.nearest(inner)
    assert np.abs(distance - 0.002).max() < 3e-5
    assert (np.einsum("ij,ij->i", inner - place, samples.normals[face]) < 0).all()
