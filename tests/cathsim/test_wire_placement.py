"""A wire placed along a way: it lies there before it rests, and stays in the branch afterwards."""

import numpy as np
import pytest

from cathsim import NavigateEnv
from cathsim.devices.arena import PROTRUSION
from cathsim.devices.simulation import DualSimulation
from cathsim.devices.wire_placement import SHAPES, inserted_starts, place_wire, plan_way, pushed_shapes


@pytest.fixture(scope="module")
def environment() -> NavigateEnv:
    return NavigateEnv("type_1", "lcca", observation="tip")


@pytest.fixture(scope="module")
def way(environment: NavigateEnv) -> np.ndarray:
    return plan_way(environment.simulation, environment.phantom.target("lcca").position)


@pytest.mark.parametrize("short_of_end", [0.01, 0.12])
def test_every_node_lies_on_the_way(environment: NavigateEnv, way: np.ndarray, short_of_end: float) -> None:
    simulation = environment.simulation
    place_wire(simulation, way, short_of_end, rest_steps=0)
    arcs = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))))
    expected = [np.interp(arcs[-1] - short_of_end, arcs, way[:, axis]) for axis in range(3)]
    assert np.linalg.norm(simulation.tip - expected) < 2e-3  # links are chords of the way
    fine = np.stack([np.interp(np.linspace(0, arcs[-1], 2000), arcs, way[:, axis]) for axis in range(3)], axis=1)
    inside = [node for node in simulation.inserted_points() if (node - way[0]) @ simulation.vessel.direction > 0]
    assert len(inside) > 3
    assert max(np.linalg.norm(fine - node, axis=1).min() for node in inside) < 2e-3


def test_a_placed_wire_is_where_the_simulator_puts_it(environment: NavigateEnv) -> None:
    simulation = environment.simulation
    simulation.reset(0.0)
    for _ in range(40):
        simulation.advance(0.002, 0.1)
    insertion, driven = simulation.insertion, simulation.inserted_points()
    assert insertion > 0.07
    entry, direction = simulation.vessel.entry, simulation.vessel.direction
    beyond = driven[(driven - entry) @ direction > 1e-3]
    place_wire(simulation, np.vstack((entry, beyond[::-1])), 0.0, rest_steps=0)
    assert simulation.insertion == pytest.approx(insertion, abs=2e-4)
    count = min(len(driven), simulation.active_links + 1)
    assert np.linalg.norm(simulation.inserted_points()[:count] - driven[:count], axis=1).max() < 3e-4


def test_wire_rests_in_the_branch_and_an_episode_can_start_there(environment: NavigateEnv, way: np.ndarray) -> None:
    simulation = environment.simulation
    place_wire(simulation, way, 0.012)
    assert simulation.valid
    assert simulation.summary.force_max < 0.5
    assert environment.task.remaining(environment.phantom, simulation.tip) < 0.03
    start = simulation.state()
    place_wire(simulation, way, 0.012)
    assert np.array_equal(simulation.state(), start)
    _, info = environment.reset(options={"start": start})
    assert info["distance"] < 0.03


def test_a_way_too_long_or_too_short_is_refused(environment: NavigateEnv, way: np.ndarray) -> None:
    with pytest.raises(ValueError, match="this one asks for -"):
        place_wire(environment.simulation, way[:2], 0.002)
    onwards = np.vstack((way, way[-1] + (0.0, 0.0, 0.5)))
    with pytest.raises(ValueError, match=r"the wire can lie 0 to 0\.\d+ m along a way"):
        place_wire(environment.simulation, onwards, 0.0)


def test_inserted_starts_lie_before_the_target(environment: NavigateEnv) -> None:
    phantom, task = environment.phantom, environment.task
    environment.reset(seed=0)
    whole = task.remaining(phantom, environment.simulation.tip)
    starts = inserted_starts(environment, np.random.default_rng(0))
    np.testing.assert_array_equal(starts, inserted_starts(environment, np.random.default_rng(0)))
    assert len(starts) >= 8
    remaining = []
    for start in starts:
        environment.reset(options={"start": start})
        remaining.append(task.remaining(phantom, environment.simulation.tip))
    assert task.success_radius < min(remaining) < 0.03
    assert max(remaining) < 0.7 * whole


def test_pushed_shapes_move_on_from_where_they_were_laid(environment: NavigateEnv, way: np.ndarray) -> None:
    simulation, entry = environment.simulation, environment.simulation.vessel.entry
    shapes = list(pushed_shapes(simulation, way, np.random.default_rng(1)))
    assert 1 <= len(shapes) <= SHAPES
    tips = np.array([shape[0] for shape in shapes])
    assert (np.linalg.norm(np.diff(tips, axis=0), axis=1) > 1e-4).all()
    assert (np.linalg.norm(tips - entry, axis=1) > 0.01).all()
    again = list(pushed_shapes(simulation, way, np.random.default_rng(1)))
    np.testing.assert_array_equal(shapes[-1], again[-1])


@pytest.fixture(scope="module")
def covered() -> NavigateEnv:
    return NavigateEnv("type_1", "lcca", catheter="vertebral", observation="devices", accuracy="fast")


@pytest.mark.parametrize(("lead", "expected"), [(None, 0.05), (-0.03, -0.03), (0.29, None)])
def test_two_devices_lie_on_the_way(
    covered: NavigateEnv, way: np.ndarray, lead: float | None, expected: float | None
) -> None:
    simulation = covered.simulation
    assert isinstance(simulation, DualSimulation)
    place_wire(simulation, way, 0.03, lead=lead, rest_steps=0)
    wire, catheter = simulation.device_insertions()
    arcs = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))))
    assert max(wire, catheter) == pytest.approx(arcs[-1] - 0.03 - PROTRUSION, abs=1e-4)
    # a catheter that would lie behind its start is parked
    assert simulation.device_lead == pytest.approx(wire if expected is None else expected, abs=1e-4)
    tip = [np.interp(arcs[-1] - 0.03, arcs, way[:, axis]) for axis in range(3)]
    assert np.linalg.norm(simulation.tip - tip) < 2e-3
