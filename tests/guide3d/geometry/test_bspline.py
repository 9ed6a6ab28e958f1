"""B-splines: fits by chord length, smoothing, few points, and the public layout."""

from __future__ import annotations

import numpy as np
import pytest

from guide3d.geometry.bspline import BSplineCurve, fit_bspline
from guide3d.geometry.polyline import arc_length

SQUARE = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 4.0]])


def circle(radius: float, count: int = 60) -> np.ndarray:
    angle = np.linspace(0.0, 1.5 * np.pi, count)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def test_spline_goes_through_its_points_by_chord_length() -> None:
    points = circle(100.0)
    curve = fit_bspline(points)
    assert np.allclose(curve.at(arc_length(points)), points, atol=1e-9)
    assert curve.domain == pytest.approx((0.0, arc_length(points)[-1]))
    between = np.linalg.norm(curve.sample(2000), axis=1)
    assert np.abs(between - 100.0).max() < 1e-3
    steps = np.linalg.norm(np.diff(curve.sample(2000), axis=0), axis=1)
    assert np.abs(steps * 1999 / np.ptp(curve.domain) - 1.0).max() < 2e-3  # chord length is nearly arc length


def test_smoothing_takes_noise_out() -> None:
    exact = circle(100.0, 200)
    noisy = exact + np.random.default_rng(0).normal(0.0, 1.0, exact.shape)
    smooth = fit_bspline(noisy, smoothing=1.0 * len(noisy))
    assert np.sqrt(np.mean((np.linalg.norm(smooth.sample(500), axis=1) - 100.0) ** 2)) < 0.5  # of the noise of 1
    with pytest.raises(ValueError, match="smoothing: expected 0 or more"):
        fit_bspline(noisy, smoothing=-1.0)


def test_points_closer_than_two_px_count_once_and_few_points_lower_the_degree() -> None:
    twice = np.array([[0.0, 0.0], [0.5, 0.3], [10.0, 0.0], [20.0, 5.0], [30.0, 0.0]])
    assert np.linalg.norm(fit_bspline(twice).at(0.5) - [0.5, 0.3]) > 0.1
    assert fit_bspline(SQUARE * 10).degree == 2
    assert fit_bspline(SQUARE[:2] * 10).degree == 1


def test_the_public_layout_round_trips() -> None:
    curve = fit_bspline(circle(80.0))
    entry = curve.to_tck(u=[0.0, 1.0])
    assert set(entry) == {"tck", "u"}
    assert len(entry["tck"]["c"]) == 2
    assert entry["u"] == [0.0, 1.0]
    back = BSplineCurve.from_tck(entry)
    u = np.linspace(*curve.domain, 30)
    assert np.array_equal(back.at(u), curve.at(u))
    padded = {"t": entry["tck"]["t"], "c": [[*row, 0, 0, 0, 0] for row in entry["tck"]["c"]], "k": 3}
    assert np.array_equal(BSplineCurve.from_tck(padded).at(u), curve.at(u))
    with pytest.raises(ValueError, match=r"\['k'\] missing"):
        BSplineCurve.from_tck({"tck": {"t": [], "c": []}})
    with pytest.raises(ValueError, match=r"expected \(n, d\) coefficients and n"):
        BSplineCurve(np.arange(5.0), np.zeros((3, 2)))
