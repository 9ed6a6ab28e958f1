"""A vessel in a box of 1.7 thousand million nodes: nothing may make it dense, which would take 7 GB."""

import os
import subprocess
import sys

import pytest

SCRIPT = """
import resource
from pathlib import Path
from sys import argv

import numpy as np

from cathsim import ACCURACY, NavigateEnv, load_guidewire
from cathsim.anatomy import Branch, Phantom, SignedDistanceGrid, VesselTree
from cathsim.anatomy.entry import locate_entries
from tests.cathsim.anatomy.lumen_report import check_lumen
from cathsim.anatomy.phantom import Target
from cathsim.anatomy.phantom_cache import PhantomCache
from cathsim.blood.field import blood_field
from cathsim.blood.flow import BloodFlow
from cathsim.console.web.messages import surface_of
from cathsim.fluoroscopy import Projector, background_image
from cathsim.planning.path import plan_path, picture

SHAPE, SPACING = (1200, 1200, 1200), 5e-4
x, y, z = np.meshgrid(*(np.arange(n) for n in (60, 60, 280)), indexing="ij")
corner = np.array([700, 300, 500])
distance = np.minimum(4e-3 - SPACING * np.hypot(x - 30, y - 30), SPACING * np.minimum(z - 40, 240 - z))
near = np.argwhere(distance > -0.01)
grid = SignedDistanceGrid.from_nodes(near + corner, distance[distance > -0.01], SHAPE, (-0.3, -0.1, 0.0), SPACING)
assert grid.nbytes < 40e6, grid.nbytes
resource.setrlimit(resource.RLIMIT_DATA, (3 << 30, 3 << 30))

start = grid.coordinates(corner + (30, 30, 40))
axis = start + np.outer(np.linspace(0.0, 0.1, 101), (0, 0, 1))
tree = VesselTree((Branch("aorta", axis, np.full(101, 4e-3)),))
goal = Target("top", "aorta", axis[60], 0.06)
phantom = Phantom("tube", "7" * 32, None, tree, grid, {"top": goal}, locate_entries(tree))
field = phantom.geodesic_field("top")
assert field.nbytes < 40e6
assert abs(field.sample(axis[20]) - 0.04) < 2e-4
assert np.allclose(phantom.bounds, [start - (4e-3, 4e-3, 0), axis[-1] + (4e-3, 4e-3, 0)], atol=1.1 * SPACING)
assert check_lumen(phantom) == []
path = plan_path(grid, phantom.entry().position, goal.position)
assert abs(path.length - 0.058) < 1e-4
picture(path, grid, Path(argv[1]) / "path.png")
assert abs(phantom.lumen_mesh.volume / (np.pi * 0.004**2 * 0.1) - 1) < 0.03
assert phantom.lumen_mesh.is_watertight
assert len(surface_of(phantom)) > 1000
camera = Projector.c_arm(centre=tuple(axis[50].tolist()), field_of_view=0.15, size=64)
assert background_image(grid, camera).std() > 1
blood_field(phantom, BloodFlow(descending_share=1.0))
try:
    phantom.target((0.0, 0.0, 0.3))
    raise AssertionError("a point outside was taken")
except ValueError as error:
    assert "nearest place inside" in str(error)
cache = PhantomCache(Path(argv[1]))
cache.write(phantom)
again = cache.read("again", phantom.hash, None)
assert np.array_equal(again.grid.blocks.nodes, grid.blocks.nodes)
assert np.array_equal(again.geodesic_field("top").sample(axis), field.sample(axis))
env = NavigateEnv(phantom, "top", observation=("roadmap", "image"), accuracy="fast")
env.reset(seed=0)
for _ in range(10):
    _, _, _, cut, info = env.step(np.array([1.0, 0.0]))
    assert not cut
assert info["insertion"] > 0.015
print("done")
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are those of Linux")
def test_everything_that_reads_grids_takes_a_large_one(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(tmp_path)],
        capture_output=True,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "done" in done.stdout
