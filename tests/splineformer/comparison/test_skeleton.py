"""Tracing of masks: whole wires, gaps, specks, empty masks; and the errors of curves."""

from __future__ import annotations

import numpy as np
import pytest

from guide3d.dataset.frame import strip_mask
from splineformer.comparison.evaluation import curve_errors
from splineformer.comparison.skeleton import trace_mask
from tests.splineformer.curves import wavy_wire

SIDE = 300


def test_whole_wire_is_traced_tip_first() -> None:
    true = wavy_wire(1, SIDE)
    traced = trace_mask(strip_mask(true, SIDE, SIDE, 6.0), true[-1])
    assert traced.pieces == 1
    assert traced.discontinuities == 0
    errors = curve_errors(traced.points_px, true)
    assert errors["mean_px"] < 2.5
    assert errors["tip_px"] < 6.0  # thinning eats half of the width at each end


def test_gap_is_counted_and_joined() -> None:
    true = wavy_wire(2, SIDE)
    mask = strip_mask(true, SIDE, SIDE, 6.0)
    mask[:, 60:85] = 0
    traced = trace_mask(mask, true[-1])
    assert traced.discontinuities == 1
    assert curve_errors(traced.points_px, true)["mean_px"] < 5


def test_speck_is_dropped_and_wide_gap_stays() -> None:
    mask = strip_mask([[5.0, 20], [150, 20]], SIDE, SIDE, 6.0)
    mask[200:204, 200:204] = 255
    assert trace_mask(mask, [0, 20]).pieces == 1
    mask |= strip_mask([[100.0, 250], [140, 250]], SIDE, SIDE, 6.0)
    traced = trace_mask(mask, [0, 20])
    assert traced.pieces == 2
    assert traced.points_px[:, 1].max() < 100


def test_empty_mask_and_no_mask() -> None:
    assert trace_mask(np.zeros((50, 60)), [0, 0]).points_px is None
    with pytest.raises(ValueError, match=r"expected \(h, w\)"):
        trace_mask(np.zeros((2, 3, 4)), [0, 0])


def test_errors_of_known_curves() -> None:
    line = np.column_stack([np.linspace(0, 100, 20), np.zeros(20)])
    assert curve_errors(line, line + np.array([0, 3])) == pytest.approx(
        {"tip_px": 3, "mean_px": 3, "max_px": 3, "chamfer_px": 3}, abs=1e-9
    )
    backwards = curve_errors(line[::-1], line)
    assert backwards["tip_px"] == pytest.approx(100)
    assert backwards["chamfer_px"] == pytest.approx(0, abs=1e-9)
    half = curve_errors(line[:10], line)
    assert half["max_px"] == pytest.approx(100 - line[9, 0], abs=1e-6)
    with pytest.raises(ValueError, match="predicted curve"):
        curve_errors(line[:1], line)
