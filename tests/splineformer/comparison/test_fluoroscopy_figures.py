"""Figures on random fluoroscopy: nothing for the truth, much for the wrong order, counts of what is missed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from guide3d.geometry.polyline import Array
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from splineformer.comparison.fluoroscopy_figures import curve_figures, figures_of, summary
from splineformer.image_input import pixels_of_shares
from splineformer.learning.fluoroscopy_pool import ONE, curve_of
from tests.splineformer.curves import wavy_wire


def test_a_curve_in_the_wrong_order_is_far_off() -> None:
    wire = wavy_wire(0)
    exact = curve_figures(wire, wire)
    assert max(exact.values()) < 0.1
    turned = curve_figures(wire[::-1], wire)
    assert turned["curve_px"] < 0.1
    assert turned["order_px"] > 20
    assert turned["tip_px"] == pytest.approx(np.hypot(*(wire[0] - wire[-1])))
    beside = curve_figures(wire + np.array([0.0, 3.0]), wire)
    assert 1.0 < beside["curve_px"] <= 3.0
    assert beside["tip_px"] == pytest.approx(3.0)


def test_what_is_missed_and_found_for_nothing_is_counted() -> None:
    images = RandomFluoroscopy(FluoroscopySettings(image_px=128, clutter=1e-6, no_wire=0.5), seed=2)
    rows: list[dict[str, Any]] = []
    for index in range(24):
        drawn = images.image(index)
        wires, curve = curve_of(drawn)
        truth: Array | None = None if curve is None else pixels_of_shares(curve, (128, 128))
        if wires == ONE and index % 2:
            truth = None
        elif wires != ONE and index % 2:
            truth = np.array([[1.0, 1.0], [20.0, 20.0]])
        rows.append(figures_of(drawn, truth))
    found = summary(rows)
    assert found["missed"] == sum(row["measured"] and not row["found"] for row in rows) > 0
    assert 0 < found["found_in_empty"] < found["empty"]
    assert found["curve_median_px"] < 0.1
    assert found["in_order"] == pytest.approx(1 - found["missed"] / found["images"])
    assert summary([])["curve_median_px"] is None
