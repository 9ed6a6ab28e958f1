"""Tests of the composite rod of two devices against theory."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim.devices.catheter import Catheter
from cathsim.physics_checks.rig import TheoryCheck
from tests.cathsim.physics_checks.two_device_theory import (
    cantilever_cases,
    coaxial_error_deg,
    default_pair,
    theoretical_hub_angle,
    tips_in_bent_sheath,
)


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


def test_a_stiff_shaft_does_not_whip() -> None:
    tips = tips_in_bent_sheath(bent(3000.0), np.radians(np.arange(0.0, 360.0, 4.0)))
    assert np.diff(tips).max() < 0.15
