"""A wire laid along a way: it lies there before it rests, and stays in the branch afterwards."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim import NavigateEnv
from cathsim.laid_wire import lay_wire
from cathsim.planning.path import plan_path


def way_to(environment: NavigateEnv) -> np.ndarray:
    """From the entry to the target, off the walls."""
    vessel, phantom = environment.simulation.vessel, environment.phantom
    goal = phantom.target(environment.task.target).position
    inside = vessel.entry + 0.003 * vessel.direction
    path = plan_path(phantom.grid, inside, goal, clearance=0.001, preferred_clearance=0.003)
    return np.vstack((vessel.entry, path.points))


@pytest.fixture(scope="module")
def environment() -> NavigateEnv:
    return NavigateEnv("type_1", "lcca", observation="tip")


@pytest.fixture(scope="module")
def way(environment: NavigateEnv) -> np.ndarray:
    return way_to(environment)


@pytest.mark.parametrize("short_of_end", [0.01, 0.05, 0.12])
def test_every_node_lies_on_the_way(environment: NavigateEnv, way: np.ndarray, short_of_end: float) -> None:
    simulation = environment.simulation
    lay_wire(simulation, way, short_of_end, rest_steps=0)
    arcs = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))))
    expected = [np.interp(arcs[-1] - short_of_end, arcs, way[:, axis]) for axis in range(3)]
    assert np.linalg.norm(simulation.tip - expected) < 2e-3  # links are chords of the way
    fine = np.stack([np.interp(np.linspace(0, arcs[-1], 2000), arcs, way[:, axis]) for axis in range(3)], axis=1)
    inside = [node for node in simulation.inserted_points() if (node - way[0]) @ simulation.vessel.direction > 0]
    assert len(inside) > 3
    assert max(np.linalg.norm(fine - node, axis=1).min() for node in inside) < 2e-3


def test_wire_rests_in_the_branch_and_an_episode_can_start_there(environment: NavigateEnv, way: np.ndarray) -> None:
    simulation = environment.simulation
    lay_wire(simulation, way, 0.012)
    assert simulation.valid
    assert simulation.summary.force_max < 0.5
    assert environment.task.remaining(environment.phantom, simulation.tip) < 0.03
    start = simulation.state()
    lay_wire(simulation, way, 0.012)
    assert np.array_equal(simulation.state(), start)
    _, info = environment.reset(options={"start": start})
    assert info["distance"] < 0.03


def test_a_way_too_long_or_too_short_is_refused(environment: NavigateEnv, way: np.ndarray) -> None:
    with pytest.raises(ValueError, match="this one asks for -"):
        lay_wire(environment.simulation, way[:2], 0.002)
    onwards = np.vstack((way, way[-1] + (0.0, 0.0, 0.5)))
    with pytest.raises(ValueError, match=r"the wire can lie 0 to 0\.\d+ m along a way"):
        lay_wire(environment.simulation, onwards, 0.0)
