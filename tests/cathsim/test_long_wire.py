"""Wires longer than the default: what is simulated follows the insertion, and far targets ask for enough wire."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim import ACCURACY, NavigateEnv, Phantom, Simulation, load_guidewire, load_phantom
from cathsim.environment import TRANSLATION_STEP

DEFAULT = load_guidewire("default")
LONG = DEFAULT.scaled(0.6)


def feed(simulation: Simulation, steps: int, translation: float = TRANSLATION_STEP) -> None:
    for step in range(steps):
        simulation.advance(translation, 0.1 * np.sin(step))


def test_only_the_inserted_part_of_a_long_wire_is_simulated(type_1: Phantom) -> None:
    default, long = (Simulation(type_1, wire, ACCURACY["fast"]) for wire in (DEFAULT, LONG))
    assert len(LONG.links) == len(DEFAULT.links) + 21
    for _ in range(5):
        for simulation in (default, long):
            feed(simulation, 10)
        assert long.active_links == default.active_links < 22
        assert long.model.nv == default.model.nv
        assert long.model.nM == default.model.nM
        assert np.abs(long.tip - default.tip).max() < 1e-4, "the wire in the sheath changes nothing"
    assert long.insertion == pytest.approx(0.1, abs=0.005)


def test_links_are_dropped_when_a_long_wire_is_drawn_back(type_1: Phantom) -> None:
    simulation = Simulation(type_1, LONG, ACCURACY["fast"])
    before = simulation.active_links
    feed(simulation, 60)
    assert simulation.active_links > before + 5
    feed(simulation, 80, -TRANSLATION_STEP)
    assert simulation.insertion < 0.002
    assert simulation.active_links == before


def test_arrays_have_the_size_of_the_whole_wire(type_1: Phantom) -> None:
    env = NavigateEnv(type_1, wire=LONG, accuracy="fast", observation=("internal", "joints", "shape", "mask"))
    observation, _ = env.reset(seed=0)
    links = len(LONG.links)
    assert observation["joints"].shape == (4 * links,)
    assert observation["internal"].shape == (28 * links,)
    assert observation["shape"].shape == (links + 1, 3)
    assert env.simulation.wire_points()[-1] == pytest.approx(
        env.simulation.vessel.entry + env.simulation.vessel.direction * (env.simulation.insertion + 0.005 - LONG.length)
    )
    # the fluoroscope sees the inserted part and the last 10 mm of the sheath, as with a short wire
    short = NavigateEnv(type_1, accuracy="fast", observation="mask")
    assert np.array_equal(observation["mask"], short.reset(seed=0)[0])


def test_state_of_a_long_wire_comes_back(type_1: Phantom) -> None:
    simulation = Simulation(type_1, LONG, ACCURACY["fast"])
    feed(simulation, 40)
    state = simulation.state()
    feed(simulation, 5)
    tip = simulation.tip
    feed(simulation, 20, -TRANSLATION_STEP)
    simulation.restore(state)
    feed(simulation, 5)
    assert np.array_equal(simulation.tip, tip)


def test_a_wire_too_short_for_its_target_says_which_would_do(type_1: Phantom) -> None:
    short = DEFAULT.scaled(0.2)
    with pytest.raises(
        ValueError,
        match=r"the wire of 200 mm is too short for rcca_end of type_1, 23\d mm from descending.*scaled\(0.28\)",
    ):
        NavigateEnv(type_1, "rcca_end", wire=short)
    assert NavigateEnv(type_1, "rcca_end", wire=DEFAULT.scaled(0.28)).simulation.max_insertion > 0.23
    # a target nearer than the end of the way needs less
    assert NavigateEnv(type_1, "lsa_end", wire=DEFAULT.scaled(0.23)).simulation.wire.length < DEFAULT.length
    with pytest.raises(ValueError, match="too short for lcca_end of bovine"):
        NavigateEnv(load_phantom("bovine"), "lcca_end", wire="thesis")
