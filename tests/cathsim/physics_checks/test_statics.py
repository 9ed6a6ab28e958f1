"""The simulated rods of one and two devices against theory."""

import math

import numpy as np
import pytest

from cathsim.devices.catheter import Catheter
from cathsim.physics_checks import AIM_PCT
from cathsim.physics_checks.rig import TheoryCheck, uniform_wire
from cathsim.physics_checks.statics import (
    EI,
    STIFFNESS_NMM2,
    Column,
    cantilever_deflection,
    elastica_deflection,
    rod_deflection,
)
from cathsim.physics_checks.unguided import pushed_forces
from cathsim.presets import ACCURACY
from tests.cathsim.physics_checks.two_device_theory import (
    cantilever_cases,
    coaxial_error_deg,
    default_pair,
    theoretical_hub_angle,
    tips_in_bent_sheath,
)


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


def bent(torsional_stiffness_nmm2: float) -> Catheter:
    return Catheter(
        shape=((0.0, 0.06, 1.8, 0.0),),
        torsional_stiffness_nmm2=torsional_stiffness_nmm2,
        taper=(0.0, 0.0),
        tip_stiffness_nmm2=300.0,
        length=0.1,
    )


@pytest.fixture(scope="module")
def cantilevers() -> list[TheoryCheck]:
    return cantilever_cases(default_pair())


def test_a_cantilever_bends_as_both_stiffnesses_together(cantilevers: list[TheoryCheck]) -> None:
    assert len({round(case.theory, 4) for case in cantilevers}) >= 8
    assert max(abs(case.error_pct) for case in cantilevers) < 0.5


def test_the_end_points_as_that_of_two_coaxial_rods() -> None:
    assert coaxial_error_deg(default_pair()) < 0.05


def test_the_tip_lags_behind_the_hub_as_in_theory() -> None:
    hubs = np.linspace(0.0, np.radians(310.0), 40)
    tips = tips_in_bent_sheath(bent(300.0), hubs)
    theory = [theoretical_hub_angle(bent(300.0), tip) for tip in tips]
    assert np.degrees(hubs[-1] - tips[-1]) > 200
    assert np.degrees(np.abs(theory - hubs)).max() < 0.5


def test_the_tip_whips_at_the_hub_angle_of_theory() -> None:
    catheter = bent(300.0)
    critical = max(theoretical_hub_angle(catheter, tip) for tip in np.linspace(0.5, 2.5, 200))
    hubs = np.radians(np.arange(300.0, 340.0, 1.0))
    tips = tips_in_bent_sheath(catheter, hubs)
    whip = int(np.argmax(np.diff(tips)))
    assert np.diff(tips)[whip] > np.pi
    assert np.degrees(hubs[whip + 1]) == pytest.approx(np.degrees(critical), abs=2.0)


def test_pushed_forces_repeat_with_their_seed() -> None:
    first = pushed_forces("type_1", 6, seed=1)
    assert first.shape == (6,)
    assert (first >= 0).all()
    np.testing.assert_array_equal(first, pushed_forces("type_1", 6, seed=1))
