"""Force prediction: samples, a network that learns, what its error means, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from enn.fitting import FitSettings
from enn.force.prediction import (
    DESK_FORCE,
    ForceNetwork,
    ForceNetworkSettings,
    ForcePredictor,
    calibration,
    fit_force,
    score,
)
from enn.force.samples import ForceSamples, force_samples, principal_components
from enn.model_file import decoded, write_model
from enn.trajectory import Trajectory
from tests.enn.imitation.drawn_point import DrawnPoint, expert

QUICK = replace(DESK_FORCE, fit=FitSettings(epochs=12, batch_size=32, learning_rate=3e-3, validation_share=0.0))


@pytest.fixture(scope="module")
def episodes() -> list[Trajectory]:
    from enn.imitation.dagger import Disturbed, record

    steers = [Disturbed(expert, np.random.default_rng(k), noise=0.4, spell_chance=0.3) for k in range(50)]
    return [record(DrawnPoint(), one, seed=k, keys=("image", "place")) for k, one in enumerate(steers)]


@pytest.fixture(scope="module")
def halves(episodes: list[Trajectory]) -> tuple[ForceSamples, ForceSamples]:
    features = [episode.observations["place"] for episode in episodes]
    return force_samples(episodes[:40], features=features[:40]), force_samples(episodes[40:])


@pytest.fixture(scope="module")
def predictor(halves: tuple[ForceSamples, ForceSamples]) -> ForcePredictor:
    return fit_force(halves[0], QUICK)[0]


def test_a_sample_is_the_end_of_a_step_and_its_force(episodes: list[Trajectory]) -> None:
    samples = force_samples(episodes[:2], images=("image",), vectors=("place",), frames=3, actions=True)
    first = episodes[0]
    images = first.observations["image"]
    np.testing.assert_array_equal(samples.images[0], np.concatenate((images[0], images[0], images[1])))
    np.testing.assert_array_equal(samples.images[2], np.concatenate((images[1], images[2], images[3])))
    np.testing.assert_allclose(samples.vectors[0], np.append(first.observations["place"][1], first.actions[0]))
    np.testing.assert_allclose(samples.forces[: len(first)], first.forces, rtol=1e-6)
    assert (samples.episodes == np.repeat([0, 1], [len(e) for e in episodes[:2]])).all()


def test_draws_are_nested_and_bounded(halves: tuple[ForceSamples, ForceSamples]) -> None:
    samples = halves[0]
    few, more = samples.drawn(10, seed=1), samples.drawn(20, seed=1)
    np.testing.assert_array_equal(few.forces, more.forces[:10])
    with pytest.raises(ValueError, match="record more episodes"):
        samples.drawn(len(samples) + 1, seed=1)


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


def test_principal_components_are_uncorrelated_and_of_unit_size() -> None:
    generator = np.random.default_rng(0)
    hidden = generator.normal(size=(300, 2))
    points = (hidden @ generator.normal(size=(2, 12))).reshape(300, 4, 3).astype(np.float32)
    parts = principal_components([points[:100], points[100:]], 6)
    assert [part.shape for part in parts] == [(100, 2), (200, 2)]
    np.testing.assert_allclose(np.cov(np.concatenate(parts).T, bias=True), np.eye(2), atol=1e-3)


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
