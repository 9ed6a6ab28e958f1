"""Distances to triangles."""

from __future__ import annotations

import numpy as np
import trimesh

from cathsim.anatomy.mesh.samples import nearest_on_triangles, sample_surface


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
