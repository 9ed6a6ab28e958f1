"""The ends of a lumen's vessels: what is told of those that are left out."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from cathsim.anatomy.mesh import lumen_vessels
from cathsim.anatomy.mesh.cavity import Cavity

SPACING = 1e-3
WIDE, NARROW = 8e-3, 4e-3  # m
MIDDLE, SIDES = 0.012, (0.03, 0.06)  # m


def _cavity() -> Cavity:
    """A wide vessel along z, closed at both ends, with two narrow ones along x."""
    x, y, z = np.stack(np.meshgrid(np.arange(70), np.arange(25), np.arange(95), indexing="ij")) * SPACING
    lumen = (np.hypot(x - MIDDLE, y - MIDDLE) < WIDE) & (z > 2e-3) & (z < 0.09)
    for side in SIDES:
        lumen |= (np.hypot(y - MIDDLE, z - side) < NARROW) & (x > MIDDLE) & (x < 0.065)
    wall = binary_dilation(lumen, np.ones((3, 3, 3))) & ~lumen
    return Cavity(lumen, wall, np.zeros(3), SPACING, "closed lumen", WIDE)


def test_an_end_that_is_found_before_a_narrow_vessel_and_left_out_later_is_told_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cavity, openings = _cavity(), np.zeros((0, 3))
    ends, notes = lumen_vessels.find_ends(cavity, openings)
    assert (len(ends), notes) == (4, ())
    found = lumen_vessels.find_end
    upper = next(end for end in ends if end.centre[0] > 0.05 and end.centre[2] > 0.045)

    def at_upper(points: np.ndarray) -> bool:
        return bool(np.linalg.norm(points[-1] - upper.centre) < 0.01)

    monkeypatch.setattr(
        lumen_vessels, "find_end", lambda c, points, *a: None if at_upper(points) else found(c, points, *a)
    )
    monkeypatch.setattr(lumen_vessels, "end_at_opening", lambda *_, **__: None)
    monkeypatch.setattr(lumen_vessels, "end_before", lambda *_: upper)
    monkeypatch.setattr(lumen_vessels, "severs", lambda end, _: end is upper)
    left, notes = lumen_vessels.find_ends(cavity, openings)
    assert len(left) == 3
    assert notes == ("1 of 4 ends of vessels left out: the wall does not surround them",)
