"""The physics checks: their theory gives known values, a case says how far the simulator is from it."""

from __future__ import annotations

import math

import pytest

from cathsim.physics_checks import AIM_PCT, LAWS, TheoryCheck, worst_error_pct
from cathsim.physics_checks.rig import uniform_wire
from cathsim.physics_checks.statics import (
    EI,
    STIFFNESS_NMM2,
    Column,
    cantilever_deflection,
    elastica_deflection,
    rod_deflection,
)
from cathsim.presets import ACCURACY


def test_small_loads_bend_by_the_linear_law_and_large_ones_less() -> None:
    assert elastica_deflection(1e-3) == pytest.approx(1e-3 / 3, rel=1e-4)
    # Bisshopp and Drucker 1945: P L^2 / EI = 1 and 10
    assert elastica_deflection(1.0) == pytest.approx(0.30172, abs=2e-5)
    assert elastica_deflection(10.0) == pytest.approx(0.81061, abs=2e-5)


def test_shooting_agrees_with_the_elliptic_integrals() -> None:
    length = 0.2
    deflection = rod_deflection(2 * EI / length**2, length, lambda s: EI)
    assert deflection / length == pytest.approx(elastica_deflection(2.0), rel=1e-5)


def test_a_simulated_cantilever_and_column_follow_theory() -> None:
    wire = uniform_wire((0.012,) * 22, STIFFNESS_NMM2)
    numerics = ACCURACY["accurate"]
    deflection = cantilever_deflection(wire, 2 * EI / wire.length**2, numerics)
    assert deflection / wire.length == pytest.approx(elastica_deflection(2.0), rel=AIM_PCT["elastica"] / 100)
    critical = Column.clamped_free(wire, numerics).critical_by_stiffness(1e-5)
    assert critical == pytest.approx(math.pi**2 * EI / (4 * wire.length**2), rel=AIM_PCT["buckling"] / 100)


def test_the_worst_error_counts_without_its_sign() -> None:
    cases = [TheoryCheck("elastica", "a", 1.01, 1.0), TheoryCheck("elastica", "b", 0.97, 1.0)]
    assert worst_error_pct(cases) == pytest.approx(3.0)
    assert set(LAWS) == set(AIM_PCT)
