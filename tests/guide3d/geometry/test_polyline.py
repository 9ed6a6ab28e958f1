"""Polylines: arc length, resampling, thinning and refusals."""

from __future__ import annotations

import numpy as np
import pytest

from guide3d.geometry.polyline import arc_length, at_length, checked, distances_to, resample, thinned

SQUARE = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 4.0]])


def circle(radius: float, count: int = 60) -> np.ndarray:
    angle = np.linspace(0.0, 1.5 * np.pi, count)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def test_arc_length_and_points_at_it() -> None:
    assert arc_length(SQUARE).tolist() == [0.0, 3.0, 7.0]
    assert at_length(SQUARE, [1.5, 5.0, 99.0]).tolist() == [[1.5, 0.0], [3.0, 2.0], [3.0, 4.0]]


def test_resampling_is_even_and_starts_at_the_tip() -> None:
    by_spacing, by_count = resample(SQUARE, spacing=1.0), resample(SQUARE, count=8)
    assert np.allclose(by_spacing, by_count)
    assert np.array_equal(by_spacing[0], SQUARE[0])
    assert len(resample(SQUARE, spacing=2.0)) == 4  # the end, 1 further, is left out
    with pytest.raises(ValueError, match="either spacing or count"):
        resample(SQUARE)
    with pytest.raises(ValueError, match="spacing above 0"):
        resample(SQUARE, spacing=0.0)


def test_thinning_keeps_both_ends() -> None:
    points = np.array([[0.0, 0], [1.0, 0], [5.0, 0], [9.0, 0], [9.5, 0]])
    assert thinned(points, 2.0)[:, 0].tolist() == [0.0, 5.0, 9.5]


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([[1.0, 2.0]], "camera A: expected at least 2 different points, got 1"),
        ([[1.0, 2.0], [1.0, 2.0]], "at least 2 different points, got 1"),
        ([1.0, 2.0], r"expected points of shape \(n, 2\), got \(2,\)"),
        ([[0.0, 0.0], [np.nan, 1.0]], "point 1 is not finite"),
        (np.zeros((0, 2)), "at least 2 different points, got 0"),
    ],
)
def test_what_is_no_polyline_is_refused(points: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        checked(points, 2, "annotation of camera A")  # type: ignore[arg-type]


def test_distance_to_a_polyline() -> None:
    line = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]])
    assert distances_to(line, [[5.0, 2.0], [12.0, 5.0], [-3.0, 4.0]]).tolist() == [2.0, 2.0, 5.0]
