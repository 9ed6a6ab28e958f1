"""Curves: places at arcs, and smoothing that keeps the ends."""

from __future__ import annotations

import numpy as np

from enn.imitation.images.wire_tracing import at_arcs, smoothed


def test_places_at_arcs_lie_between_the_points_and_not_beyond_the_ends() -> None:
    points = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 4.0, 0.0]])
    found = at_arcs(points, np.array([0.0, 2.0, 6.0]), np.array([1.0, 4.0, 9.0]))
    np.testing.assert_allclose(found, [[1, 0, 0], [2, 2, 0], [2, 4, 0]])


def test_smoothing_keeps_ends_and_straight_lines_and_takes_noise_away() -> None:
    line = np.linspace((0.0, 1.0), (10.0, 6.0), 41)
    np.testing.assert_allclose(smoothed(line, 7), line, atol=1e-12)
    noisy = line + np.random.default_rng(0).normal(0, 0.1, line.shape)
    found = smoothed(noisy, 7)
    np.testing.assert_allclose(found[[0, -1]], noisy[[0, -1]], atol=1e-12)
    assert np.abs(found - line)[3:-3].std() < 0.6 * np.abs(noisy - line)[3:-3].std()
    np.testing.assert_array_equal(smoothed(line[:1], 7), line[:1])
