"""A reconstructed curve, in either order, with or without what lies in the sheath, becomes the one from the entry."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim.anatomy import load_phantom
from cathsim.anatomy.centreline import arc_length, resampled
from cathsim.statics import curve_from_entry
from cathsim.statics.observed_curve import observed_curve


@pytest.mark.parametrize("tip_first", [True, False])
def test_the_sheath_is_cut_off_whatever_the_order(resting, tip_first: bool) -> None:
    nodes = resting.simulation.wire_points()
    assert np.linalg.norm(nodes[-1] - resting.curve[0]) > 0.04  # the rest lies in the sheath
    curve = curve_from_entry(nodes if tip_first else nodes[::-1], resting.phantom)
    np.testing.assert_allclose(curve[-1], resting.curve[-1])
    assert arc_length(curve)[-1] == pytest.approx(arc_length(resting.curve)[-1], abs=1e-3)
    found, wanted = (observed_curve(points, resting.phantom, "descending", 0.31) for points in (curve, resting.curve))
    assert found.length == pytest.approx(wanted.length, abs=5e-4)
    assert np.abs(found.at(np.linspace(0, 0.2, 50)) - wanted.at(np.linspace(0, 0.2, 50))).max() < 1e-3


def test_a_curve_that_begins_beyond_the_sheath_stays_whole(resting) -> None:
    points = resampled(resting.curve, 1e-3)[4:]
    np.testing.assert_allclose(curve_from_entry(points[::-1], resting.phantom), points)


def test_another_entry_is_the_beginning() -> None:
    phantom = load_phantom("type_1")
    gate = phantom.entry("ascending")
    line = gate.position + np.linspace(-0.03, 0.02, 51)[:, None] * gate.direction
    curve = curve_from_entry(line, phantom, "ascending")
    np.testing.assert_allclose(curve[[0, -1]], [gate.position, line[-1]], atol=1e-9)


@pytest.mark.parametrize(
    ("curve", "said"),
    [
        (np.zeros((1, 3)), "2 points at least"),
        ([[0.0, 0.0, np.nan], [0.0, 0.0, 1.0]], "finite"),
        ("wire", "numbers of shape"),
        (np.array([[0.0, 0.0, 5.0], [0.0, 0.0, 6.0]]), "give the whole wire up to the sheath, in m"),
    ],
)
def test_what_is_no_curve_to_the_entry_is_refused(resting, curve: object, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        curve_from_entry(curve, resting.phantom)
    with pytest.raises(ValueError, match="unknown entry"):
        curve_from_entry(resting.curve, resting.phantom, "nowhere")
