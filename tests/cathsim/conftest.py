"""Fixtures of the simulator's tests: phantoms built once into a cache of the test run, and environments on them."""

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from cathsim import ACCURACY, GUIDEWIRES, NavigateEnv, Phantom, Simulation, load_phantom
from cathsim.anatomy.entry import Entry
from cathsim.anatomy.lumen import build_lumen
from cathsim.anatomy.vessel_tree import Branch, VesselTree
from cathsim.contact import hulls as hulls_module
from cathsim.contact.hull_vessel import hull_vessel
from cathsim.contact.hulls import Hull
from tests.cathsim.makers import MakeEnv, MakeSimulation

BEND_RADIUS = 0.007  # m


@pytest.fixture
def type_1() -> Phantom:
    return load_phantom("type_1")


@pytest.fixture
def make_env() -> Iterator[MakeEnv]:
    """Makes environments with the fast preset unless asked otherwise, and closes them."""
    made: list[NavigateEnv] = []

    def make(**arguments: Any) -> NavigateEnv:
        made.append(NavigateEnv(**{"accuracy": "fast", **arguments}))
        return made[-1]

    yield make
    for env in made:
        env.close()


@pytest.fixture
def make_simulation(type_1: Phantom) -> MakeSimulation:
    """Makes simulations of a preset wire in the Type I arch with the fast preset, unless asked otherwise."""

    def make(wire: str = "default", accuracy: str = "fast", **arguments: Any) -> Simulation:
        numerics = arguments.pop("numerics", ACCURACY[accuracy])
        return Simulation(arguments.pop("phantom", type_1), GUIDEWIRES[wire], numerics, **arguments)

    return make


@pytest.fixture(scope="session")
def bend() -> Phantom:
    """A vessel of 7 mm radius that bends by 60 degrees over 63 mm, from +z towards +x."""
    angle = np.linspace(0.0, np.pi / 3, 61)
    points = 0.060 * np.column_stack((1 - np.cos(angle), np.zeros(61), np.sin(angle)))
    tree = VesselTree((Branch("aorta", points, np.full(61, BEND_RADIUS)),))
    entry = Entry("descending", np.array([0.0, 0.0, 0.002]), np.array([0.0, 0.0, 1.0]))
    grid = build_lumen(tree, resolution=1e-3, fillet_radius=1e-3)
    return Phantom("bend", "bend", None, tree, grid, {}, {"descending": entry})


@pytest.fixture(scope="session")
def made_prisms(bend: Phantom) -> list[Hull]:
    branch = bend.tree.root
    side = np.array([0.0, 1.0, 0.0])
    rings = []
    for centre, tangent in zip(branch.points[::4], branch.tangents[::4], strict=True):
        angle = np.arange(16) * np.pi / 8
        outward = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * np.cross(tangent, side)
        rings.append([centre + radius * outward for radius in (BEND_RADIUS, BEND_RADIUS + 0.004)])
    return [
        hulls_module._convex(np.array([ring[k][i % 16] for ring in pair for k in (0, 1) for i in (j, j + 1)]))
        for pair in itertools.pairwise(rings)
        for j in range(16)
    ]


@pytest.fixture
def prisms(made_prisms: list[Hull], monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Hull]]:
    """Hulls of the bend's wall by hand, 16 around and one every 4 mm or so, in the place of CoACD's."""
    monkeypatch.setattr(hulls_module, "decompose", lambda phantom, settings: made_prisms)
    hull_vessel.cache_clear()
    yield made_prisms
    hull_vessel.cache_clear()
