"""Which room of a surface is its lumen, on pipes."""

import numpy as np
import pytest
import trimesh

from cathsim.anatomy.mesh.cavity import find_cavity
from cathsim.anatomy.mesh.report import MeshRefusedError
from cathsim.anatomy.mesh.samples import sample_surface

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
