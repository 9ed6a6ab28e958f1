"""Centre lines: the ridge below the pixel, gaps, and how sure both are."""

from __future__ import annotations

import numpy as np

from guide3d.geometry.polyline import distances_to
from guide3d.reading.path_drawing import CentrelineSettings, centre_line
from tests.guide3d.reading.drawn_maps import bent, maps_of

COURSE = bent([(80, 0.02), (150, -0.004), (150, 0.0)], (150, 120), 0.0)


def test_a_shifted_path_goes_back_to_the_ridge() -> None:
    wire = maps_of(COURSE, 512).wire
    shifted = COURSE + np.random.default_rng(0).normal(0, 0.6, COURSE.shape) + [0.8, -0.8]
    line, confidence, deviation = centre_line(shifted, wire, CentrelineSettings())
    off = distances_to(COURSE, line[3:-3])
    assert off.mean() < 0.25
    assert off.max() < 1.0
    assert confidence.min() > 0.7
    assert np.allclose(deviation, 0.7)


def test_a_gap_has_no_confidence_and_a_growing_deviation() -> None:
    maps = maps_of(COURSE, 512, gaps=((200, 300),))
    line, confidence, deviation = centre_line(COURSE[::8], maps.wire, CentrelineSettings())
    middle = int(np.hypot(*(line - COURSE[250]).T).argmin())
    assert confidence[middle] < 0.05
    assert deviation[middle] > 4.0
    assert distances_to(COURSE, line).max() < 3.0
