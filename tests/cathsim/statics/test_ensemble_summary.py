"""An ensemble's sums become medians and intervals; contacts are matched by place and side."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim.statics.ensemble_summary import summarise, weighted_quantiles
from cathsim.statics.resting_contacts import RestingContacts


def member(*contacts: tuple[float, float, float], shape_error: float = 0.0) -> RestingContacts:
    """Contacts, each a distance from the tip (m), a normal force (N) and a side (1 or -1)."""
    at, normal, side = (
        (np.array(column, float) for column in zip(*contacts, strict=True))
        if contacts
        else (
            np.zeros(0),
            np.zeros(0),
            np.zeros(0),
        )
    )
    points = np.stack([at, 0 * at, 0 * at], axis=1)
    return RestingContacts(points, np.stack([0 * at, side * normal, 0 * at], axis=1), normal, at, shape_error)


def test_sums_of_the_middle_member_are_shown() -> None:
    members = [member((0.1, force, 1.0), (0.2, 0.5 * force, -1.0)) for force in (0.8, 1.0, 1.2)]
    found = summarise(members, 0.2, 0.1)
    assert found.normal_sum.value == pytest.approx(1.5)
    assert found.resultant.value == pytest.approx(0.5)
    assert found.largest.value == pytest.approx(1.0)
    np.testing.assert_allclose(found.normal_forces, [1.0, 0.5])
    assert found.normal_sum.low < 1.5 < found.normal_sum.high
    assert (found.insertion, found.rotation, found.members) == (0.2, 0.1, 3)
    np.testing.assert_allclose(found.presence, 1.0)


def test_contacts_are_matched_by_place_and_side() -> None:
    other_side, elsewhere = member((0.1, 1.0, -1.0)), member((0.15, 1.0, 1.0))
    shown = member((0.1, 1.0, 1.0))
    found = summarise([shown, member((0.105, 1.0, 1.0)), other_side, elsewhere], 0.0, 0.0)
    assert found.presence == pytest.approx([0.5])
    assert 0.1 <= found.from_tip_90[0, 0] <= found.from_tip_90[0, 1] <= 0.105


def test_a_member_far_from_the_curve_hardly_counts() -> None:
    near = [member((0.1, 1.0, 1.0)) for _ in range(3)]
    found = summarise([*near, *(member((0.1, 9.0, 1.0), shape_error=8e-3) for _ in range(3))], 0.0, 0.0)
    assert found.normal_sum.value == pytest.approx(1.0)
    assert found.normal_sum.high < 1.1


def test_no_contact_is_no_force() -> None:
    found = summarise([member(), member()], 0.1, 0.0)
    assert (found.normal_sum.value, found.resultant.high, found.largest.low) == (0.0, 0.0, 0.0)
    assert found.points.shape == (0, 3)
    assert found.normal_forces_90.shape == (0, 2)


def test_weighted_quantiles_of_equal_weights_are_the_usual_ones() -> None:
    values = np.arange(101.0)
    np.testing.assert_allclose(weighted_quantiles(values, np.ones(101), (0.1, 0.5, 0.9)), [9.6, 50.0, 90.4])
