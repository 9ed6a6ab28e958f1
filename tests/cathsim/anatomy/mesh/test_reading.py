"""Reading a mesh: every format, faces without vertices, welding and closing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from cathsim.anatomy import MeshRefusedError
from cathsim.anatomy.mesh.openings import close_openings
from cathsim.anatomy.mesh.reading import Triangles, clean_triangles, read_triangles


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
