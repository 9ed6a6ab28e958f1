"""A camera's view: what it measures from the tip, what has changed, and what it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splineformer.navigation.camera_view import AGO, RAYS, WAY_ARCS, CameraView, ViewSettings
from splineformer.navigation.perception import WireReading
from splineformer.navigation.vessel_map import VesselMap
from tests.splineformer.navigation.drawn_moments import bend, straight

SETTINGS = ViewSettings(tokens=5, encoded=8, guided=True)


def test_view_is_measured_from_the_tip() -> None:
    vessels = VesselMap(bend(), (0.9, 0.19))
    view = CameraView(SETTINGS, vessels.target, vessels)
    first = view.look(straight((0.19, 0.6)))
    assert first.shape == (SETTINGS.size,)
    way = SETTINGS.geometry - 2 * len(WAY_ARCS) - 2 - 2 * RAYS
    ahead = first[way : way + 2 * len(WAY_ARCS)].reshape(-1, 2)
    assert np.allclose(ahead[2], (1, 0), atol=0.15)  # upwards is straight ahead of a wire that comes from below
    changes = first[way - 5 - 5 * len(AGO) : way - 5].reshape(len(AGO), 5)
    assert np.allclose(changes, (0, 0, 1, 0, 0), atol=1e-6)  # nothing before: nothing has moved
    second = view.look(straight((0.19, 0.59), 0.41))
    moved = second[way - 5 - 5 * len(AGO) : way - 5].reshape(len(AGO), 5)
    assert np.allclose(moved[0], (0.5, 0, 1, 0, 0.5), atol=1e-4)  # a hundredth forwards, over a fiftieth
    with pytest.raises(ValueError, match="guided by a contrast run"):
        CameraView(SETTINGS, vessels.target)
    with pytest.raises(ValueError, match="5 tokens and 8 encoder outputs"):
        view.look(WireReading(np.zeros((4, 3), np.float32), first[:2].reshape(1, 2), np.zeros(8, np.float32), 1.0))


def test_a_view_does_not_depend_on_where_the_wire_is() -> None:
    settings = replace(SETTINGS, guided=False)
    looks = []
    for shift in (0.0, 0.2):
        view = CameraView(settings, (0.5 + shift, 0.3))
        looks.append(view.look(straight((0.4 + shift, 0.5))))
    moved = np.flatnonzero(~np.isclose(*looks, atol=1e-5))
    # the tip's place and the mark's place in the image alone
    tip = 3 * settings.tokens + 2 * 9 + 2
    assert moved.tolist() == [tip, settings.geometry - 2]
    assert np.array_equal(looks[0][-settings.encoded :], np.zeros(8))
