"""Distances between curves against cases known by hand."""

from __future__ import annotations

import numpy as np
import pytest

from guide3d.geometry.metrics import chamfer, curve_metrics, distances_along, frechet, max_ed, mers, mete

LINE = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]])


def test_a_shifted_line_is_off_by_its_shift_everywhere() -> None:
    shifted = LINE + np.array([0.0, 2.0, 0.0])
    assert curve_metrics(LINE, shifted) == pytest.approx(
        {"max_ed": 2.0, "mete": 2.0, "mers": 2.0, "frechet": 2.0, "chamfer": 2.0}
    )
    assert curve_metrics(LINE, LINE) == pytest.approx(
        dict.fromkeys(("max_ed", "mete", "mers", "frechet", "chamfer"), 0.0)
    )


def test_a_turned_line_is_off_by_its_arc() -> None:
    turned = np.array([[0.0, 0.0, 0.0], [0.0, 10.0, 0.0]])
    assert max_ed(LINE, turned) == pytest.approx(10.0 * np.sqrt(2.0))
    assert mete(LINE, turned) == 0.0
    assert mers(LINE, turned) == pytest.approx(5.0 * np.sqrt(2.0))


def test_points_are_compared_at_equal_arc_length_up_to_the_shorter_length() -> None:
    bent = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [4.0, 3.0, 0.0]])
    along = distances_along(LINE, bent)
    assert len(along) == 8
    assert along[4] == 0.0
    assert along[-1] == pytest.approx(3.0 * np.sqrt(2.0))
    longer = np.array([[0.0, 0.0, 0.0], [30.0, 0.0, 0.0]])
    assert max_ed(LINE, longer) == 0.0
    assert frechet(LINE, longer) == pytest.approx(20.0)
    assert chamfer(LINE, longer) == pytest.approx(np.maximum(np.arange(31) - 10, 0).mean() / 2)


def test_frechet_keeps_the_order_that_chamfer_ignores() -> None:
    back = LINE[::-1]
    assert chamfer(LINE, back) == pytest.approx(0.0)
    assert frechet(LINE, back) == pytest.approx(10.0)


def test_frechet_lies_between_the_ends_and_a_walk_over_the_corners() -> None:
    rng = np.random.default_rng(3)
    for _ in range(5):
        a, b = (np.cumsum(rng.normal(size=(count, 3)), axis=0) for count in (7, 9))
        # over the corners alone: no less than over all points between them
        distance = np.linalg.norm(a[:, None] - b[None], axis=2)
        best = np.full(distance.shape, np.inf)
        for i in range(len(a)):
            for j in range(len(b)):
                before = min(
                    (best[k, m] for k, m in ((i - 1, j), (i, j - 1), (i - 1, j - 1)) if k >= 0 and m >= 0), default=0.0
                )
                best[i, j] = max(before, distance[i, j])
        fine = frechet(a, b, spacing_mm=0.01)
        assert max(mete(a, b), np.linalg.norm(a[-1] - b[-1])) - 1e-9 <= fine <= best[-1, -1] + 0.02


def test_bad_curves_are_refused() -> None:
    with pytest.raises(ValueError, match="curve b: expected at least 2 different points"):
        mete(LINE, LINE[:1])
    with pytest.raises(ValueError, match=r"curve a: expected points of shape \(n, 3\)"):
        max_ed(LINE[:, :2], LINE)
    with pytest.raises(ValueError, match="spacing_mm"):
        mers(LINE, LINE, spacing_mm=0.0)
