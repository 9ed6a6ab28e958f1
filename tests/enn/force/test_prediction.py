"""Force prediction: samples, a network that learns, what its error means, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from enn.force.evaluation import score
from enn.force.prediction import DESK_FORCE, ForceNetwork, ForceNetworkSettings, ForcePredictor, fit_force
from enn.force.samples import ForceSamples
from enn.model_file import decoded, write_model
from tests.enn.force.conftest import QUICK


def test_predicts_far_better_than_the_mean(
    predictor: ForcePredictor, halves: tuple[ForceSamples, ForceSamples]
) -> None:
    result = score(predictor.predict(halves[1].images), halves[1].forces)
    assert result.share_of_variance < 0.2
    assert result.correlation > 0.9


def test_the_loss_on_features_makes_the_network_predict_them(halves: tuple[ForceSamples, ForceSamples]) -> None:
    samples = halves[0]
    network = fit_force(samples, QUICK)[0].network
    assert samples.features is not None
    with torch.no_grad():
        features, _ = network(torch.as_tensor(samples.images), torch.as_tensor(samples.vectors))
    wanted = (samples.features - samples.features.mean(0)) / samples.features.std(0)
    assert np.square(features.numpy() - wanted).mean() < 0.3
    plain = fit_force(replace(samples, features=None), replace(QUICK, fit=replace(QUICK.fit, epochs=1)))[0]
    assert plain.network.features is None


def test_saved_predictor_predicts_the_same(
    predictor: ForcePredictor, halves: tuple[ForceSamples, ForceSamples], tmp_path: Path
) -> None:
    predictor.save(tmp_path / "p.pt")
    loaded = ForcePredictor.load(tmp_path / "p.pt")
    np.testing.assert_array_equal(loaded.predict(halves[1].images), predictor.predict(halves[1].images))
    content = decoded((tmp_path / "p.pt").read_bytes())
    content["settings"]["hidden"] = [7]
    write_model(tmp_path / "other.pt", content)
    with pytest.raises(ValueError, match="another architecture"):
        ForcePredictor.load(tmp_path / "other.pt")


def test_refuses_other_shapes_and_numbers_that_are_none(predictor: ForcePredictor) -> None:
    with pytest.raises(ValueError, match=r"images of shape \(1, 40, 40\) and 0 numbers, got \(1, 48, 48\)"):
        predictor.predict(np.zeros((2, 1, 48, 48), np.uint8))
    numbers = ForcePredictor(ForceNetwork(ForceNetworkSettings(image_shape=(0, 40, 40), vector=3)))
    with pytest.raises(ValueError, match="not finite"):
        numbers.predict(np.zeros((1, 0, 40, 40), np.uint8), np.full((1, 3), np.nan, np.float32))
    with pytest.raises(ValueError, match="got neither"):
        ForceNetworkSettings(image_shape=(0, 40, 40))
    with pytest.raises(ValueError, match="channels, height and width above 0"):
        ForceNetworkSettings(image_shape=(1, 0, 40))


def test_predicts_from_numbers_alone(halves: tuple[ForceSamples, ForceSamples]) -> None:
    training = halves[0]
    nothing = np.zeros((len(training), 0, 0, 0), np.uint8)
    numbers = np.tile(training.forces[:, None], (1, 3)).astype(np.float32)
    known = replace(training, images=nothing, vectors=numbers, features=None)
    settings = replace(DESK_FORCE, fit=replace(DESK_FORCE.fit, epochs=2))
    predictor, _ = fit_force(known, settings, seed=0)
    assert predictor.network.settings.image_shape == (0, 0, 0)
    assert predictor.predict(nothing[:5], numbers[:5]).shape == (5,)
    with pytest.raises(ValueError, match="vectors hold a value that is not finite"):
        ForceSamples(
            np.zeros((1, 1, 40, 40), np.uint8), np.full((1, 2), np.inf, np.float32), np.zeros(1), np.zeros(1, np.int64)
        )
