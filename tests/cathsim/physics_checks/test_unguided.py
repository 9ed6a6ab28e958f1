"""Runs without an operator repeat with their seed."""

from __future__ import annotations

import numpy as np

from cathsim.physics_checks.unguided import pushed_forces


def test_pushed_forces_repeat_with_their_seed() -> None:
    first = pushed_forces("type_1", 6, seed=1)
    assert first.shape == (6,)
    assert (first >= 0).all()
    np.testing.assert_array_equal(first, pushed_forces("type_1", 6, seed=1))
