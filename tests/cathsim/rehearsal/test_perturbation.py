"""Copies of an anatomy: how far they differ, and that copy 0 is the scan."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim import Phantom, load_guidewire
from cathsim.rehearsal.perturbation import Perturbation, copy_of

WIRE = load_guidewire("default")


def test_copy_0_is_the_scan(type_1: Phantom) -> None:
    assert copy_of(type_1, WIRE, Perturbation(), 0) == {"phantom": type_1, "wire": WIRE}


def test_a_copy_is_the_same_every_time(type_1: Phantom) -> None:
    one, two = (copy_of(type_1, WIRE, Perturbation(), 4) for _ in range(2))
    assert one["phantom"] is two["phantom"]
    assert one["wire"] == two["wire"] != WIRE
    assert one["breathing"] == two["breathing"]
    assert np.array_equal(one["scan"].shift, two["scan"].shift)


def test_differences_fill_their_ranges_and_stay_within(type_1: Phantom) -> None:
    copies = [copy_of(type_1, WIRE, Perturbation(walls=0.0), seed) for seed in range(1, 200)]
    assert all(copy["phantom"] is type_1 for copy in copies)
    shifts = np.array([copy["scan"].shift for copy in copies])
    turns = np.degrees([np.linalg.norm(copy["scan"].turn) for copy in copies])
    stiffness = np.array([copy["wire"].shaft_stiffness_nmm2 / WIRE.shaft_stiffness_nmm2 for copy in copies])
    tips = np.array([copy["wire"].tip_stiffness_nmm2 / WIRE.tip_stiffness_nmm2 for copy in copies])
    friction = np.array([copy["wire"].friction / WIRE.friction for copy in copies])
    breaths = np.array([copy["breathing"].amplitude for copy in copies])
    np.testing.assert_allclose(tips, stiffness)
    for values, low, high in (
        (shifts, -0.003, 0.003),
        (turns, 0.0, 3.0),
        (stiffness, 0.7, 1.3),
        (friction, 0.7, 1.3),
        (breaths, 0.0, 0.005),
    ):
        assert low <= values.min() < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < values.max() <= high
    caudal = [copy["breathing"].farthest[2] / copy["breathing"].amplitude for copy in copies]
    assert max(caudal) < 0.0
    assert np.mean(caudal) < -0.7


def test_a_share_of_the_differences() -> None:
    half = Perturbation().scaled(0.5)
    assert half.walls == 0.5e-3
    assert half.period == 4.0
    assert half.friction == pytest.approx(0.15)
    with pytest.raises(ValueError, match=r"walls must lie in 0 to 0.02 m, got 1"):
        Perturbation(walls=1)
