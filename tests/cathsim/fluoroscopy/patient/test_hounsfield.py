"""Attenuation from Hounsfield units."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim.fluoroscopy.materials import ATTENUATION
from cathsim.fluoroscopy.patient.ct_body import BONE_FACTOR, WATER, attenuation


def test_air_water_and_bone() -> None:
    assert attenuation(-1000) == 0
    assert attenuation(0) == pytest.approx(WATER)
    assert attenuation(-1024) == 0
    # cortical bone has 1,593 Hounsfield units at 70 keV and this attenuation at 60
    assert attenuation(1593) == pytest.approx(ATTENUATION["bone"], rel=0.01)
    assert 1.15 < BONE_FACTOR < 1.25


def test_two_lines_that_meet_at_water() -> None:
    values = attenuation(np.linspace(-1000, 2000, 301))
    assert (np.diff(values) > 0).all()
    np.testing.assert_allclose(np.diff(values[:100], 2), 0, atol=1e-9)
    np.testing.assert_allclose(np.diff(values[101:], 2), 0, atol=1e-9)
