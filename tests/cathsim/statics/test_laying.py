"""A device laid along a curve lies there, whatever the feeder's rotation."""

from __future__ import annotations

import numpy as np
import pytest

from cathsim.devices.arena import PROTRUSION
from cathsim.statics.feeder import Feeder
from cathsim.statics.laying import distance_to, lay_along
from cathsim.statics.observed_curve import ObservedCurve, observed_curve


@pytest.mark.parametrize("rotation", [0.0, 2.0])
def test_links_point_along_the_curve(resting, rotation: float) -> None:
    simulation, state = resting.simulation, resting.simulation.state()
    unsmoothed = ObservedCurve(resting.curve, simulation.insertion + PROTRUSION)
    lay_along(simulation, unsmoothed, Feeder(simulation.insertion, rotation))
    assert simulation.rotation == rotation
    assert np.linalg.norm(simulation.tip - resting.curve[-1]) < 1e-3
    assert distance_to(simulation, unsmoothed) < 1e-3  # links are chords
    assert not simulation.data.qvel.any()
    simulation.restore(state)


def test_a_curve_beside_the_entry_is_moved_to_it(resting) -> None:
    simulation, state = resting.simulation, resting.simulation.state()
    aside = np.cross(simulation.vessel.direction, [1.0, 0.0, 0.0])
    offset = 1e-3 * aside / np.linalg.norm(aside)
    curve = ObservedCurve(resting.curve + offset, simulation.insertion + PROTRUSION)
    lay_along(simulation, curve, Feeder(simulation.insertion, 0.0))
    assert np.linalg.norm(simulation.tip - resting.curve[-1]) < 1e-3
    simulation.restore(state)


def test_the_inserted_curve_has_the_feeders_length(resting) -> None:
    curve = observed_curve(resting.curve, resting.phantom, "descending", 0.31)
    assert curve.insertion == pytest.approx(resting.simulation.insertion, abs=1.5e-3)  # its tip is sharply bent
    np.testing.assert_allclose(resting.curve[0], resting.simulation.vessel.entry, atol=1e-3)
