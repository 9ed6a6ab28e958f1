"""The chains of a wire: hysteresis, and states that pass between them."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim import GUIDEWIRES, load_guidewire
from cathsim.devices.active_chain import HYSTERESIS, SPACING, ActiveChains, pass_on
from cathsim.devices.arena import PROTRUSION, RESERVE, max_insertion


@pytest.mark.parametrize("wire", GUIDEWIRES)
def test_a_chain_reaches_from_zero_to_the_whole_wire(wire: str) -> None:
    chain = GUIDEWIRES[wire]
    chains = ActiveChains.of(chain)
    assert chains.counts[-1] == len(chain.links)
    assert chains.reach[-1] == pytest.approx(max_insertion(chain))
    assert chains.reach[0] >= 0
    assert list(chains.counts) == sorted(set(chains.counts))
    assert chains.counts[0] > chain.motor_joints, "the tip's motors need their joints on every chain"
    for count, reach in zip(chains.counts, chains.reach, strict=True):
        assert reach == pytest.approx(sum(chain.links[-count:]) - PROTRUSION - RESERVE)
    assert np.diff(chains.reach).min() >= SPACING - 1e-9


def test_a_rung_always_holds_the_insertion() -> None:
    chains = ActiveChains.of(GUIDEWIRES["default"])
    index = 0
    for insertion in np.concatenate((np.linspace(0, chains.reach[-1], 300), np.linspace(chains.reach[-1], 0, 300))):
        index = chains.index_for(float(insertion), index)
        assert chains.reach[index] >= insertion - 1e-9
    assert index == 0


def test_a_rung_is_kept_within_the_hysteresis() -> None:
    chains = ActiveChains.of(GUIDEWIRES["default"])
    edge = chains.reach[3]
    assert chains.index_for(edge + 1e-4, 3) == 4
    assert chains.index_for(edge - 1e-4, 4) == 4
    assert chains.index_for(edge - HYSTERESIS - 1e-4, 4) == 3
    assert chains.index_for(edge - 1e-4) == 3, "without a present chain the shortest counts"


def test_state_passes_to_a_longer_chain_and_back() -> None:
    state = np.arange(1.0, 9.0)
    longer = pass_on(state, 12, bend=True)
    assert longer.tolist() == [1, 2, 0, 0, 0, 0, 3, 4, 5, 6, 7, 8]
    assert np.array_equal(pass_on(longer, 8, bend=True), state)


def test_dropped_bends_keep_the_direction_of_the_wire() -> None:
    state = np.array([0.1, 0.2, 0.01, 0.02, 0.03, 0.04, 0.5, 0.6])
    assert pass_on(state, 4, bend=True) == pytest.approx([0.1, 0.2, 0.54, 0.66])
    assert pass_on(state, 4, bend=False) == pytest.approx([0.1, 0.2, 0.5, 0.6])


def test_a_long_wire_has_more_rungs_of_the_same_tip() -> None:
    short, long = load_guidewire("default"), load_guidewire("default").scaled(0.5)
    assert ActiveChains.of(long).counts[: len(ActiveChains.of(short).counts)] == ActiveChains.of(short).counts
