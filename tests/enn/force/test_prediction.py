"""Prediction of force from images: samples, the network, its scores."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from enn.fitting import EpisodeFitSettings
from enn.force.evaluation import calibration, evaluate_predictor, score
from enn.force.prediction import DESK_FORCE, ForceNetwork, ForceNetworkSettings, ForcePredictor, fit_force
from enn.force.samples import ForceInputs, ForceSamples, force_samples, matched_features, split_episodes
from enn.imitation.dagger import DisturbanceSettings, Disturbed, record
from enn.trajectory import Trajectory
from tests.enn.imitation.drawn_point import DrawnPoint, expert

QUICK = replace(DESK_FORCE, fit=EpisodeFitSettings(epochs=12, batch_size=32, learning_rate=3e-3, validation_share=0.0))
Halves = tuple[ForceSamples, ForceSamples]


@pytest.fixture(scope="module")
def episodes() -> list[Trajectory]:
    """Episodes in which the force depends on the image."""
    size = DisturbanceSettings(noise=0.4, spell_chance=0.3)
    steers = [Disturbed(expert, np.random.default_rng(k), size) for k in range(50)]
    return [record(DrawnPoint(), one, seed=k, keys=("image", "place")) for k, one in enumerate(steers)]


@pytest.fixture(scope="module")
def halves(episodes: list[Trajectory]) -> Halves:
    features = [episode.observations["place"] for episode in episodes]
    return force_samples(episodes[:40], features=features[:40]), force_samples(episodes[40:])


@pytest.fixture(scope="module")
def predictor(halves: Halves) -> ForcePredictor:
    return fit_force(halves[0], QUICK)[0]


def test_predicts_far_better_than_the_mean(predictor: ForcePredictor, halves: Halves) -> None:
    result = score(predictor.predict(halves[1].images), halves[1].forces)
    assert result.share_of_variance < 0.2
    assert result.correlation > 0.9


def test_refuses_other_shapes_and_numbers_that_are_none(predictor: ForcePredictor) -> None:
    numbers = ForcePredictor(ForceNetwork(ForceNetworkSettings(image_shape=(0, 40, 40), vector=3)))
    none, wide = np.zeros((1, 0, 40, 40), np.uint8), np.zeros((2, 1, 48, 48), np.uint8)
    refusals: list[tuple[Callable[[], object], str]] = [
        (lambda: predictor.predict(wide), r"images of shape \(1, 40, 40\) and 0 numbers, got \(1, 48, 48\)"),
        (lambda: numbers.predict(none, np.full((1, 3), np.nan, np.float32)), "not finite"),
        (lambda: ForceNetworkSettings(image_shape=(0, 40, 40)), "got neither"),
        (lambda: ForceNetworkSettings(image_shape=(1, 0, 40)), "channels, height and width above 0"),
    ]
    for call, said in refusals:
        with pytest.raises(ValueError, match=said):
            call()


def test_predicts_from_numbers_alone(halves: Halves) -> None:
    training = halves[0]
    nothing = np.zeros((len(training), 0, 0, 0), np.uint8)
    numbers = np.tile(training.forces[:, None], (1, 3)).astype(np.float32)
    known = replace(training, images=nothing, vectors=numbers, features=None)
    settings = replace(DESK_FORCE, fit=replace(DESK_FORCE.fit, epochs=1))
    predictor, _ = fit_force(known, settings, seed=0)
    assert predictor.network.settings.image_shape == (0, 0, 0)
    assert predictor.predict(nothing[:5], numbers[:5]).shape == (5,)
    with pytest.raises(ValueError, match="vectors hold a value that is not finite"):
        ForceSamples(
            np.zeros((1, 1, 40, 40), np.uint8), np.full((1, 2), np.inf, np.float32), np.zeros(1), np.zeros(1, np.int64)
        )


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
    predictor: ForcePredictor, halves: Halves
) -> None:
    training, test = halves
    outcome = evaluate_predictor(predictor, training, test, seed=1)
    assert outcome["mse_n2"] < 0.5 * outcome["mean_mse_n2"] < 0.5 * outcome["untrained_mse_n2"]
    assert outcome["share_pct"] == pytest.approx(100 * outcome["mse_n2"] / outcome["variance_n2"])
    assert outcome["force_max_n"] == test.forces.max()


def test_a_sample_is_the_end_of_a_step_and_its_force(episodes: list[Trajectory]) -> None:
    samples = force_samples(episodes[:2], ForceInputs(vectors=("place",)))
    first = episodes[0]
    images = first.observations["image"]
    np.testing.assert_array_equal(samples.images[2], images[3])
    np.testing.assert_allclose(samples.vectors[0], first.observations["place"][1])
    np.testing.assert_allclose(samples.forces[: len(first)], first.forces, rtol=1e-6)
    assert (samples.episodes == np.repeat([0, 1], [len(e) for e in episodes[:2]])).all()


def test_matched_features_are_the_experts_and_the_shape(episodes: list[Trajectory]) -> None:
    class Expert:
        keys = ("place",)

        def features(self, observations: dict[str, np.ndarray]) -> np.ndarray:
            return 2 * observations["place"]

    for episode in episodes[:3]:
        episode.observations["shape"] = np.random.default_rng(len(episode)).normal(size=(len(episode) + 1, 5, 3))
    features = matched_features(episodes[:3], Expert())
    np.testing.assert_array_equal(features[1][:, :2], 2 * episodes[1].observations["place"])
    assert [part.shape for part in features] == [(len(one) + 1, 2 + 15) for one in episodes[:3]]


def test_draws_are_nested_and_bounded(halves: Halves) -> None:
    samples = halves[0]
    few, more = samples.drawn(10, seed=1), samples.drawn(20, seed=1)
    np.testing.assert_array_equal(few.forces, more.forces[:10])
    with pytest.raises(ValueError, match="record more episodes"):
        samples.drawn(len(samples) + 1, seed=1)


def test_every_so_many_th_episode_is_held_out(episodes: list[Trajectory]) -> None:
    learnt, tested = split_episodes(episodes[:9], 4)
    assert [id(one) for one in tested] == [id(episodes[3]), id(episodes[7])]
    assert len(learnt) == 7
    assert [len(part) for part in split_episodes(episodes[:3], 4)] == [2, 1]
    assert [len(part) for part in split_episodes(episodes[:1], 4)] == [1, 1]
