"""The load cell: what it reads of a wire at rest, in flowing blood, and what filter, noise and rounding do."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim.anatomy import Phantom, load_phantom
from cathsim.guidewire import Guidewire
from cathsim.metrics.load_cell import MINI40, LoadCell, step_forces
from cathsim.presets import ACCURACY
from cathsim.simulation import Simulation

CLEAN = LoadCell(resolution=(0.0, 0.0, 0.0), cutoff=0.0)


@pytest.fixture(scope="module")
def phantom() -> Phantom:
    return load_phantom("type_1")


def rested(phantom: Phantom, blood: str | None = None) -> Simulation:
    from cathsim.blood.flow import blood_flow

    flow = None if blood is None else blood_flow(blood)
    simulation = Simulation(phantom, Guidewire(), ACCURACY["accurate"], blood=flow)
    for _ in range(90):
        simulation.advance(0.002, 0.02)
    for _ in range(60):
        simulation.advance(0.0, 0.0)
    return simulation


@pytest.mark.parametrize("blood", [None, "steady"])
def test_load_along_the_sheath_is_the_feeders_push(phantom: Phantom, blood: str | None) -> None:
    simulation = rested(phantom, blood)
    forces, along = step_forces(simulation), simulation.vessel.direction
    push = float(simulation.data.actuator_force[0])
    assert abs(push) > 0.005
    # the sheath has no friction: what the feeder pushes with, the vessel gets, with the blood's drag on the wire
    assert forces.load @ along == pytest.approx(push, rel=0.03, abs=2e-4)
    if blood is not None:
        drag = simulation.blood_forces().sum(axis=0)
        assert np.linalg.norm(drag) > 1e-4
        assert forces.load == pytest.approx(-np.array(simulation.summary.mean_force) - drag, abs=1e-12)


def test_load_is_below_the_sum_of_magnitudes_and_holds_a_largest_contact(phantom: Phantom) -> None:
    simulation = rested(phantom)
    forces = step_forces(simulation)
    assert np.linalg.norm(forces.load) < forces.magnitude_sum
    assert 0 < forces.largest_contact < forces.magnitude_sum
    assert forces.sheath.shape == (3,)


def test_a_clean_cell_reads_the_load() -> None:
    loads = np.random.default_rng(0).normal(0.3, 0.1, (50, 3))
    assert np.array_equal(CLEAN.read(loads, interval=0.1, generator=np.random.default_rng(1)), loads)


def test_a_step_of_load_rises_as_a_filter_of_first_order() -> None:
    loads = np.concatenate((np.zeros((1, 3)), np.ones((9, 3))))
    cell = LoadCell(resolution=(0.0, 0.0, 0.0), cutoff=0.5)
    readings = cell.read(loads, interval=0.1, generator=np.random.default_rng(0))
    time = 0.1 * np.arange(10)
    assert readings[:, 0] == pytest.approx(1 - np.exp(-2 * np.pi * 0.5 * time))


@pytest.mark.parametrize("name", sorted(MINI40))
def test_noise_and_rounding_are_those_of_the_calibration(name: str) -> None:
    cell = MINI40[name]
    readings = cell.read(np.zeros((4000, 3)), interval=0.1, generator=np.random.default_rng(0))
    steps = np.array(cell.resolution)
    assert readings / steps == pytest.approx((readings / steps).round(), abs=1e-9)
    assert readings.std(axis=0) == pytest.approx(steps * np.sqrt(1 + 1 / 12), rel=0.05)


def test_a_tared_cell_starts_at_zero() -> None:
    loads = np.full((5, 3), 0.2)
    loads[2:] = 0.5
    cell = LoadCell(resolution=(0.0, 0.0, 0.0), cutoff=0.0, tared=True)
    readings = cell.read(loads, interval=0.1, generator=np.random.default_rng(0))
    assert readings[:, 0] == pytest.approx([0.0, 0.0, 0.3, 0.3, 0.3])
    assert CLEAN.read(np.zeros((0, 3)), interval=0.1, generator=np.random.default_rng(0)).shape == (0, 3)


def test_loads_that_are_none_are_refused() -> None:
    for loads in (np.zeros((4, 2)), np.full((4, 3), np.nan)):
        with pytest.raises(ValueError, match=r"expected finite loads of shape \(T, 3\)"):
            CLEAN.read(loads, interval=0.1, generator=np.random.default_rng(0))
    with pytest.raises(ValueError, match="resolution"):
        LoadCell(resolution=(-1.0, 0.0, 0.0))
