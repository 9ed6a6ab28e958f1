"""The steps of a mesh import one by one: reading, welding, centrelines, cross sections, names, targets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from cathsim.anatomy import MeshRefusedError, SignedDistanceGrid
from cathsim.anatomy.centreline import LumenPaths, resampled, smoothed
from cathsim.anatomy.cross_section import wall_distances
from cathsim.anatomy.mesh.branches import RoughVessel
from cathsim.anatomy.mesh.naming import name_vessels, ordered_names, propose_targets, renamed, world_rotation
from cathsim.anatomy.mesh.openings import close_openings
from cathsim.anatomy.mesh.reading import Triangles, clean_triangles, read_triangles
from cathsim.anatomy.mesh.samples import SurfaceSamples, nearest_on_triangles, sample_surface
from cathsim.anatomy.vessel_tree import Branch, VesselTree


def _surface(mesh: Triangles) -> SurfaceSamples:
    return sample_surface(mesh.corners, 5e-4)


def test_faces_of_vertices_that_are_not_there_are_refused(tmp_path: Path):
    path = tmp_path / "box.ply"
    trimesh.creation.box((1, 1, 1)).export(path, encoding="ascii")
    assert len(read_triangles(path).faces) == 12
    head, _, body = path.read_text().partition("end_header\n")
    lines = body.splitlines()
    for wrong in ("3 0 1 99", "3 0 1 -2"):
        path.write_text(f"{head}end_header\n" + "\n".join([*lines[:-1], wrong]) + "\n")
        with pytest.raises(MeshRefusedError, match=r"box\.ply (has faces of vertices|cannot be read)"):
            read_triangles(path)


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


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply"])
def test_every_format_is_read(suffix: str, tmp_path: Path):
    path = tmp_path / f"box{suffix}"
    trimesh.creation.box((1, 2, 3)).export(path)
    mesh = read_triangles(path)
    assert len(mesh.faces) == 12
    assert np.allclose(np.ptp(mesh.bounds, axis=0), [1, 2, 3])


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


def test_centrelines_of_a_tee():
    inside = np.zeros((60, 30, 90), dtype=bool)
    x, y, z = np.indices(inside.shape)
    inside |= ((x - 15) ** 2 + (y - 15) ** 2 <= 100) & (z >= 5) & (z < 85)
    inside |= ((z - 45) ** 2 + (y - 15) ** 2 <= 25) & (x >= 15) & (x < 58)
    paths = LumenPaths(inside, np.zeros(3), 1e-3)
    ends = paths.ends()
    assert len(ends) == 3
    assert sorted(int(end[2] > 45) + int(end[2] > 20) for end in ends) == [0, 1, 2]
    (way,) = paths.ways(ends[0], ends[1:2])
    assert (way[0] == ends[0]).all()
    assert (way[-1] == ends[1]).all()
    middle = way[(np.abs(way[:, 2] - 25) < 8)]
    assert np.abs(middle[:, :2] - 15).max() <= 2  # it keeps to the tube's axis


def test_smoothing_keeps_the_ends():
    arc = np.linspace(0, 0.1, 101)
    rough = np.stack([arc, 5e-4 * (-1) ** np.arange(101), 0 * arc], axis=1)
    calm = smoothed(rough, 3e-3)
    assert np.array_equal(calm[[0, -1]], rough[[0, -1]])
    assert np.abs(calm[10:-10, 1]).max() < 1e-4
    assert np.allclose(np.diff(resampled(rough[::100], 1e-3)[:, 0]), 1e-3)


def test_cross_sections():
    spacing = 1e-3
    x, y, _ = np.meshgrid(*[np.arange(-15, 16) * spacing] * 3, indexing="ij")
    grid = SignedDistanceGrid(6e-3 - np.hypot(x, y), np.full(3, -15e-3), spacing)
    reach, rays = wall_distances(grid, np.array([[1e-3, 0, 0]]), np.array([[0, 0, 1.0]]), rays=24)
    assert reach.shape == (24, 1)
    ends = np.array([1e-3, 0, 0]) + reach[..., None] * rays
    assert np.abs(np.linalg.norm(ends, axis=-1) - 6e-3).max() < 1e-4


def _vessel(start: list[float], end: list[float], radius: float, number: int | None) -> RoughVessel:
    points = np.linspace(start, end, 40)
    return RoughVessel(points, np.full(40, radius), number)


def _arch() -> RoughVessel:
    angle = np.linspace(0, np.pi, 60)
    bow = np.stack([0.035 * np.cos(angle), 0 * angle, 0.035 * np.sin(angle)], axis=1)
    down = np.linspace([0.035, 0, -0.1], [0.035, 0, 0], 60)
    aorta = RoughVessel(np.concatenate([down, bow]), np.full(120, 0.012), 0)
    for x, radius, number in ((0.02, 0.004, 1), (0.0, 0.0035, 2), (-0.02, 0.006, 3)):
        child = _vessel([x, 0, 0.03], [1.5 * x, 0, 0.09], radius, number)
        child.start = 0.1 + 0.035 * (np.arccos(x / 0.035))
        aorta.children.append(child)
    return aorta


def test_names_follow_the_arch_and_the_users():
    aorta = _arch()
    rotation, kept = world_rotation(aorta)
    assert kept is False or np.allclose(np.abs(rotation).max(axis=1), 1)
    assert rotation[2] @ [0, 0, 1] > 0.95
    names, notes = name_vessels(aorta)
    assert [names[id(child)] for child in aorta.children] == ["lsa", "lcca", "bca"]
    assert notes == ()
    assert ordered_names(aorta, names, ["a", "b", "c"]) == {"bca": "a", "lcca": "b", "lsa": "c"}
    swapped = renamed(names, {"lcca": "lsa", "lsa": "lcca"})
    assert [swapped[id(child)] for child in aorta.children] == ["lcca", "lsa", "bca"]
    with pytest.raises(MeshRefusedError, match="names refer to rca, which was not found; found are aorta, "):
        renamed(names, {"rca": "bca"})
    with pytest.raises(MeshRefusedError, match="names must differ"):
        renamed(names, {"lcca": "lsa"})
    with pytest.raises(
        MeshRefusedError, match=r"2 names were given for the 3 branches of the aorta \(bca, lcca, lsa\)"
    ):
        ordered_names(aorta, names, ["a", "b"])


def test_a_common_trunk_is_recognised():
    aorta = _arch()
    del aorta.children[1]
    left = _vessel([-0.02, 0, 0.05], [0.025, 0, 0.09], 0.0035, 4)
    aorta.children[-1].children.append(left)
    names, notes = name_vessels(aorta)
    assert names[id(left)] == "lcca"
    assert [names[id(child)] for child in aorta.children] == ["lsa", "bca"]
    assert "common trunk" in notes[0]


def test_targets_move_into_short_branches(tee: VesselTree):
    targets, notes = propose_targets(tee)
    assert targets["bca"].arc == pytest.approx(tee["bca"].length - 5e-3)
    assert notes == ("target bca lies 27 mm up its branch instead of 30: the branch is short",)
    stub = Branch("bca", tee["bca"].points[:16], tee["bca"].radius[:16], "aorta", 0.04)
    targets, notes = propose_targets(VesselTree((tee.root, stub)))
    assert targets == {}
    assert notes == ("no target in bca: it is only 7 mm long",)
