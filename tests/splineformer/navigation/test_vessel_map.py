"""The contrast run's map: its lumen whatever the brightness, and ways that stay inside."""

from __future__ import annotations

import numpy as np
import pytest

from splineformer.navigation.vessel_map import VesselMap, lumen_of_run
from tests.splineformer.navigation.drawn_moments import bend


def test_contrast_run_shows_the_lumen_whatever_the_brightness() -> None:
    true = np.kron(bend(), np.ones((4, 4)))
    plain = np.full((256, 256), 150.0)
    plain[:20] = 2.0  # behind the collimator
    contrast = 0.9 * plain * np.exp(-0.8 * true)
    noise = np.random.default_rng(0).normal(0, 1.5, (2, 256, 256))
    lumen = lumen_of_run((plain + noise[0]).clip(0, 255), (contrast + noise[1]).clip(0, 255), size=64)
    seen = bend() > 0.5
    seen[:5] = False
    assert np.array_equal(lumen > 0.5, seen)
    with pytest.raises(ValueError, match="shows no vessel"):
        lumen_of_run(plain, plain)
    with pytest.raises(ValueError, match="square images of one shape"):
        lumen_of_run(plain, contrast[:100])


def test_way_stays_in_the_lumen_and_ends_at_the_mark() -> None:
    vessels = VesselMap(bend(), (0.9, 0.19))
    way = vessels.way(np.array([0.19, 0.9]))
    assert np.allclose(way[0], (0.19, 0.9))
    assert np.allclose(way[-1], (0.9, 0.19))
    assert (vessels.sample(way) > 0.5).all()
    length = np.linalg.norm(np.diff(way, axis=0), axis=1).sum()
    assert 1.2 < length < 1.45  # the diagonal would be 1.0
    assert vessels.remaining(np.array([0.19, 0.9])) > vessels.remaining(np.array([0.19, 0.5])) > 0
    with pytest.raises(ValueError, match="must lie in the image"):
        VesselMap(bend(), (1.2, 0.5))


def test_lumen_at_places_is_that_of_the_nearest_cells_and_of_the_border_outside() -> None:
    vessels = VesselMap(bend(), (0.9, 0.19))
    assert vessels.sample(np.array([0.19, 0.5])) == 1.0
    assert vessels.sample(np.array([0.5, 0.5])) == 0.0
    assert vessels.sample(np.array([[0.19, 0.5], [3.0, 0.5]])).tolist() == [1.0, 0.0]
