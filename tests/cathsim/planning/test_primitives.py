"""Tests of the motion primitives."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim.planning.sampling import BEYOND, EMERGED, motion_primitives, wire_advances


@pytest.mark.parametrize("actions", [2, 4])
def test_plans_of_one_length_that_differ(actions: int) -> None:
    plans = motion_primitives(actions, 7)
    assert plans.shape[1:] == (7, actions)
    assert np.abs(plans).max() <= 1.0
    assert len(np.unique(plans.reshape(len(plans), -1), axis=0)) == len(plans)


def test_each_device_is_moved_by_some_plan() -> None:
    plans = motion_primitives(4, 6)
    for action in range(4):
        assert {-1.0, 1.0} & set(np.unique(np.sign(plans[:, :, action])))
    pulled_back = (plans[:, :3, 2] < 0) & (plans[:, 3:, 0] > 0)
    assert pulled_back.any(), "a reverse curve is engaged by drawing the catheter back"


def test_plans_that_bring_the_wire_out_are_as_long_as_it_takes() -> None:
    plans = wire_advances(-0.08, 0.002)
    assert len(plans) > 3
    for plan in plans:
        assert plan.shape[1] == 4
        assert 0.002 * plan[:, 0].sum() == pytest.approx(0.08 + BEYOND, abs=0.002)
    assert len(wire_advances(EMERGED, 0.002)) == 0
