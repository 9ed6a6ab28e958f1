"""Materials of catheters: walls over the water that they displace, and markers."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim.fluoroscopy import catheter_material
from cathsim.fluoroscopy.curve import ROUND_END
from cathsim.fluoroscopy.materials import ATTENUATION, LEAST_MARKER, flat_marker

WATER = ATTENUATION["water"]


def material(marker_length: float = 3e-3, lumen: str = "water"):
    return catheter_material(1e-3, 0.6e-3, wall=170.0, marker=1430.0, marker_length=marker_length, lumen=lumen)


def test_a_tube_counts_over_the_water_that_it_displaces() -> None:
    marker, shaft = material().sections
    assert shaft.depth(0.0) == pytest.approx((170.0 - WATER) * 0.8e-3)
    assert marker.depth(0.0) == pytest.approx((1430.0 - WATER) * 0.8e-3)
    assert shaft.depth(0.8e-3) == pytest.approx((170.0 - WATER) * 2 * np.sqrt(1 - 0.64) * 1e-3)
    assert shaft.depth(1.1e-3) == 0.0
    assert material(lumen="blood").sections[-1].depth(0.0) > shaft.depth(0.0)


def test_without_a_marker_there_is_one_section() -> None:
    assert len(material(0.0).sections) == 1
    assert flat_marker(material(0.0)) == material(0.0)


def test_a_marker_with_a_round_end_covers_as_much_as_one_with_flat_ends() -> None:
    radius = 1e-3
    drawn = flat_marker(material()).sections[0].length
    assert 2 * radius * drawn + np.pi * radius**2 / 2 == pytest.approx(2 * radius * 3e-3)
    assert flat_marker(material(0.7e-3)).sections[0].length == LEAST_MARKER
    assert pytest.approx(np.pi / 4) == ROUND_END
