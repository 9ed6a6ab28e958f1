"""Evaluation of force prediction: known numbers, calibration, what a predictor is compared with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from enn.force.evaluation import calibration, evaluate_predictor, score
from enn.force.prediction import ForcePredictor
from enn.force.samples import ForceSamples


def test_score_of_known_numbers() -> None:
    result = score(np.array([1.0, 2.0, 3.0]), np.array([1.0, 2.0, 6.0]))
    assert result.mse_n2 == pytest.approx(3.0)
    assert result.variance_n2 == pytest.approx(14 / 3)
    assert result.share_of_variance == pytest.approx(9 / 14)
    assert score(np.zeros(4), np.arange(4.0)).correlation == 0.0
    with pytest.raises(ValueError, match="as many predicted as true"):
        score(np.zeros(2), np.zeros(3))


def test_calibration_bins_by_predicted_force() -> None:
    bins = calibration(np.array([3.0, 1.0, 2.0, 4.0]), np.array([30.0, 10.0, 20.0, 50.0]), bins=2)
    assert bins["predicted"].tolist() == [1.5, 3.5]
    assert bins["true"].tolist() == [15.0, 40.0]
    assert bins["true_sd"].tolist() == [5.0, 10.0]


def test_a_predictor_is_compared_with_the_mean_and_an_untrained_network(
    predictor: ForcePredictor, halves: tuple[ForceSamples, ForceSamples]
) -> None:
    training, test = halves
    outcome = evaluate_predictor(predictor, training, test, seed=1)
    assert outcome["mse_n2"] < 0.5 * outcome["mean_mse_n2"] < 0.5 * outcome["untrained_mse_n2"]
    assert outcome["share_pct"] == pytest.approx(100 * outcome["mse_n2"] / outcome["variance_n2"])
    assert outcome["force_max_n"] == test.forces.max()
    assert outcome["untrained_mse_n2"] == evaluate_predictor(predictor, training, test, seed=1)["untrained_mse_n2"]


def test_forces_that_are_all_the_same_have_no_share(
    predictor: ForcePredictor, halves: tuple[ForceSamples, ForceSamples]
) -> None:
    still = replace(halves[1], forces=np.zeros_like(halves[1].forces))
    outcome = evaluate_predictor(predictor, halves[0], still)
    assert (outcome["variance_n2"], outcome["share_pct"]) == (0.0, None)
