"""An ensemble has the deviations that it was asked for, and its noise the width."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim.statics.uncertainty import Deviation, Uncertainty, deviations, smooth_noise


def test_members_spread_as_asked() -> None:
    sizes = Uncertainty(stiffness=0.2, insertion=2e-3, rotation=0.1, registration=1e-3, lumen=3e-4, friction=0.5)
    members = deviations(201, sizes, 4)
    assert members[0] == Deviation()
    rest = members[1:]
    assert np.std(np.log([one.stiffness for one in rest])) == pytest.approx(0.2, rel=0.05)
    assert np.std([one.insertion for one in rest]) == pytest.approx(2e-3, rel=0.05)
    assert np.std([one.rotation for one in rest]) == pytest.approx(0.1, rel=0.05)
    np.testing.assert_allclose(np.std([one.shift for one in rest], axis=0), 1e-3, rtol=0.05)
    assert np.std([one.lumen for one in rest]) == pytest.approx(3e-4, rel=0.05)
    assert len({one.lumen for one in rest}) == 4
    assert np.std(np.log([one.friction for one in rest])) == pytest.approx(0.5, rel=0.05)


def test_the_same_seed_gives_the_same_members() -> None:
    assert deviations(9, Uncertainty(), 1) == deviations(9, Uncertainty(), 1)
    assert deviations(9, Uncertainty(), 1) != deviations(9, Uncertainty(), 2)
    assert deviations(1, Uncertainty(), 0) == [Deviation()]


def test_wider_uncertainties_keep_the_draws() -> None:
    narrow, wide = (deviations(9, Uncertainty(insertion=size), 1) for size in (1e-3, 2e-3))
    for one, other in zip(narrow, wide, strict=True):
        assert other.insertion == pytest.approx(2 * one.insertion)
        assert (other.stiffness, other.shift, other.curve_seed) == (one.stiffness, one.shift, one.curve_seed)


def test_noise_has_its_deviation_and_width() -> None:
    noise = smooth_noise(40_000, 1e-3, 0.010, np.random.default_rng(0))
    assert noise.std() == pytest.approx(1.0, abs=0.05)
    # the autocorrelation of noise filtered by a Gaussian falls to exp(-1) at twice its deviation
    assert np.mean(noise[20:] * noise[:-20]) == pytest.approx(np.exp(-1), abs=0.06)
