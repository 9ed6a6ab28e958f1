"""The parts of a chain that its devices are."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim.devices.pair import points_behind, wire_and_catheter

LINKS = (0.02, 0.01, 0.01)  # from the proximal end, m
POINTS = np.array([[0.0, 0.0, z] for z in (0.04, 0.03, 0.02, 0.0)])


@pytest.mark.parametrize(
    ("behind", "heights"),
    [
        (0.0, [0.04, 0.03, 0.02, 0.0]),
        (0.004, [0.036, 0.03, 0.02, 0.0]),
        (0.01, [0.03, 0.02, 0.0]),
        (0.03, [0.01, 0.0]),
        (0.05, [0.0]),
    ],
)
def test_a_part_begins_where_it_should(behind: float, heights: list[float]) -> None:
    np.testing.assert_allclose(points_behind(POINTS, LINKS, behind)[:, 2], heights, atol=1e-15)


def test_the_device_that_is_ahead_has_the_chains_tip() -> None:
    for lead in (0.015, -0.015):
        wire, catheter = wire_and_catheter(POINTS, LINKS, lead)
        ahead, other = (wire, catheter) if lead > 0 else (catheter, wire)
        np.testing.assert_array_equal(ahead, POINTS)
        assert other[0, 2] == pytest.approx(0.025)
