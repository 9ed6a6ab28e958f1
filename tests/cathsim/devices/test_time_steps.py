"""Time stepping of a wire in a catheter: its own repetitions, what old logs say, and what the repetitions are for."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from cathsim.anatomy import load_phantom
from cathsim.devices.pair import DevicePair
from cathsim.devices.shelf import load_catheter
from cathsim.devices.simulation import DualSimulation
from cathsim.guidewire import load_guidewire
from cathsim.presets import ACCURACY, Accuracy


def made(numerics: Accuracy, catheter: str = "simmons2") -> DualSimulation:
    pair = DevicePair(load_guidewire("default"), load_catheter(catheter))
    return DualSimulation(load_phantom("type_1"), pair, numerics, measure_penetration=True)


def ahead(simulation: DualSimulation, steps: int = 110) -> tuple[np.ndarray, float]:
    """Tips of the wire that goes ahead, and the deepest penetration."""
    tips, deepest = [], 0.0
    for _ in range(steps):
        simulation.advance(0.002, 0.0, catheter=(0.001, 0.0))
        tips.append(simulation.tip)
        deepest = max(deepest, simulation.depths.max())
    return np.array(tips), deepest


@pytest.mark.parametrize("name", ACCURACY)
def test_numerics_with_a_catheter_are_their_own(name: str) -> None:
    numerics = ACCURACY[name].with_catheter
    assert numerics.with_catheter == numerics  # as a log that holds them is played again
    assert made(ACCURACY[name]).numerics == numerics


def test_a_log_of_before_is_stepped_as_then() -> None:
    recorded = {"timestep": 0.01, "refinement": 8, "tolerance": 2e-4, "rise": 5e-5, "mass_scale": 10.0}
    struct = made(Accuracy(**recorded))._chain.struct
    assert (struct.refinement, struct.deep) == (8, 2.0)
    struct = made(ACCURACY["accurate"])._chain.struct
    assert (struct.refinement, struct.deep) == (3, 1.5)


def test_fewer_repetitions_keep_the_devices_where_they_were() -> None:
    usual = ACCURACY["accurate"]
    more, depth_of_more = ahead(made(dataclasses.replace(usual, catheter_refinement=8, catheter_deep=2.0)))
    fewer, depth = ahead(made(usual))
    _, depth_of_none = ahead(made(dataclasses.replace(usual, catheter_refinement=1)))
    assert np.median(np.linalg.norm(fewer - more, axis=1)) < 5e-4
    assert depth < 2 * depth_of_more < depth_of_none
