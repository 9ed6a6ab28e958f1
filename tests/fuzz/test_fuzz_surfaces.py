"""Surfaces: damaged files and surfaces with faces missing, turned, doubled or moved."""

import logging
import random
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cathsim.anatomy import import_mesh
from tests.cathsim.anatomy.generator.drawn_arch import arch_mesh
from tests.fuzz.mutations import damaged
from tests.fuzz.promise import BrokenPromiseError, fuzz, refused

COARSE = 2.5e-3  # m


@pytest.fixture(scope="module")
def mesh() -> trimesh.Trimesh:
    """An arch."""
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    return arch_mesh(0.03)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where damaged files go."""
    return tmp_path_factory.mktemp("surfaces")


@fuzz(2005, seconds=120, megabytes=3000, slow=True)
def test_surfaces_imported(rng: random.Random, mesh: trimesh.Trimesh, folder: Path) -> str:
    """The import gives a phantom with a lumen and targets, or a refusal, within the import's own budget."""
    path = folder / f"victim.{rng.choice(('obj', 'ply', 'stl'))}"
    if rng.random() < 0.7:
        mesh.export(path)
        path.write_bytes(damaged(path.read_bytes(), rng))
    else:
        altered(mesh, rng).export(path)
    try:
        phantom = import_mesh(path, resolution=COARSE, cache_dir=folder / "cache")
    except ValueError as error:
        return refused(error)
    ends = np.array([target.position for target in phantom.targets.values()])
    if not np.isfinite(ends).all() or not phantom.targets:
        raise BrokenPromiseError("a phantom without finite targets was imported")
    return "accepted"


def altered(mesh: trimesh.Trimesh, rng: random.Random) -> trimesh.Trimesh:
    """A mesh with faces missing, turned, doubled or of other vertices, or with vertices moved."""
    draw = np.random.default_rng(rng.randrange(2**32))
    vertices, faces = mesh.vertices.copy(), mesh.faces.copy()
    kind = rng.randrange(6)
    if kind == 0:
        faces = faces[draw.random(len(faces)) < rng.choice((0.5, 0.9, 0.99))]
    elif kind == 1:
        turned = draw.random(len(faces)) < 0.5
        faces[turned] = faces[turned, ::-1]
    elif kind == 2:
        vertices += draw.normal(size=vertices.shape) * rng.choice((1e-4, 1e-3, 1e-2))
    elif kind == 3:
        vertices *= np.array(rng.choice(((1, 1, 0), (1e-6, 1e-6, 1e-6), (1e6, 1e6, 1e6), (1, 1, 5))))
    elif kind == 4:
        faces = np.concatenate((faces, faces[draw.integers(len(faces), size=2000)]))
    else:
        faces = draw.integers(len(vertices), size=(500, 3))
    return trimesh.Trimesh(vertices, faces, process=False)
