"""What a navigator sees through the network: views, marks, features, fine-tuning."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from guide3d.geometry.polyline import resample
from splineformer.build import VARIANTS
from splineformer.image_input import picture_of
from splineformer.navigation.camera_view import AGO, RAYS, WAY_ARCS, CameraView, ViewSettings
from splineformer.navigation.fine_tuning import CURVE_POINTS, WirePictures, errors, fine_tune
from splineformer.navigation.navigator_perception import EpisodeView, NavigatorPerception, NavigatorPerceptionSettings
from splineformer.navigation.perception import SIDE_PX, PerceptionNetwork, WireReading, picture_of_moment
from splineformer.navigation.space_view import SIZE
from splineformer.navigation.vessel_map import VesselMap
from splineformer.predictor import Predictor
from tests.splineformer.curves import image_of, wavy_wire
from tests.splineformer.navigation.drawn_moments import bend, perception_network, straight

STILL = np.zeros(2, np.float32)


@pytest.fixture(scope="module")
def network() -> PerceptionNetwork:
    return perception_network()


def settings_of(network: PerceptionNetwork, **changed: object) -> NavigatorPerceptionSettings:
    plain = NavigatorPerceptionSettings(tokens=network.tokens, encoded=network.encoded, guided=False)
    return replace(plain, **changed)  # type: ignore[arg-type]


def test_features_of_many_episodes_are_those_of_each(network: PerceptionNetwork) -> None:
    settings = settings_of(network, cameras=("a", "b"))
    perception = NavigatorPerception(settings, network)
    marks = {"a": (0.9, 0.2), "b": (0.3, 0.4)}

    def views() -> list[EpisodeView]:
        images = [[image_of(wavy_wire(2 * k + n)) for n in (0, 1)] for k in range(3)]
        return [EpisodeView(settings, lambda shown=shown: shown, marks) for shown in images]

    together = perception(views(), [None] * 3, [STILL] * 3)
    assert together.shape == (3, settings.size)
    for one, view in zip(together, views(), strict=True):
        np.testing.assert_allclose(perception([view], [None], [STILL])[0], one, atol=1e-4)
    for first, length in settings.encoder_blocks:
        own = network(views()[0].images())[settings.encoder_blocks.index((first, length))]
        np.testing.assert_allclose(together[0, first : first + length], own.encoded, atol=1e-4)


def test_each_camera_has_its_own_mark_and_map() -> None:
    settings = NavigatorPerceptionSettings(cameras=("a", "b"), tokens=5, encoded=8)
    marks = {"a": (0.9, 0.19), "b": (0.8, 0.19)}
    maps = {name: VesselMap(bend(), mark) for name, mark in marks.items()}
    reading, size = straight((0.19, 0.6)), settings.view.size
    features = EpisodeView(settings, list, marks, maps).look([reading, reading], STILL)
    for place, name in enumerate("ab"):
        alone = CameraView(settings.view, marks[name], maps[name]).look(reading)
        np.testing.assert_array_equal(features[place * size : (place + 1) * size], alone)


def test_says_what_is_missing(network: PerceptionNetwork) -> None:
    settings, marks = settings_of(network), {"a": (0.5, 0.5), "b": (0.5, 0.5)}
    both = replace(settings, cameras=("a", "b"), guided=True)
    refusals: list[tuple[Callable[[], object], str]] = [
        (lambda: EpisodeView(settings, list, {"b": (0.5, 0.5)}), "camera a: give"),
        (lambda: NavigatorPerception(settings, perception_network("published")), "the one that it was trained with"),
        (lambda: replace(settings, cameras=("a", "a")), "each once"),
        (lambda: replace(settings, guided=True, space=True), "by two cameras and their contrast"),
        (lambda: EpisodeView(both, list, marks), "guided by a contrast run"),
        (lambda: EpisodeView(replace(both, space=True), list, marks), "the map that both contrast runs make"),
    ]
    for call, said in refusals:
        with pytest.raises(ValueError, match=said):
            call()
    assert replace(both, space=True).size == both.size + SIZE


SETTINGS = ViewSettings(tokens=5, encoded=8, guided=True)


def test_view_is_measured_from_the_tip() -> None:
    vessels = VesselMap(bend(), (0.9, 0.19))
    view = CameraView(SETTINGS, vessels.target, vessels)
    first = view.look(straight((0.19, 0.6)))
    assert first.shape == (SETTINGS.size,)
    way = SETTINGS.geometry - 2 * len(WAY_ARCS) - 2 - 2 * RAYS
    ahead = first[way : way + 2 * len(WAY_ARCS)].reshape(-1, 2)
    assert np.allclose(ahead[2], (1, 0), atol=0.15)  # upwards is straight ahead of a wire that comes from below
    changes = first[way - 5 - 5 * len(AGO) : way - 5].reshape(len(AGO), 5)
    assert np.allclose(changes, (0, 0, 1, 0, 0), atol=1e-6)  # nothing before: nothing has moved
    second = view.look(straight((0.19, 0.59), 0.41))
    moved = second[way - 5 - 5 * len(AGO) : way - 5].reshape(len(AGO), 5)
    assert np.allclose(moved[0], (0.5, 0, 1, 0, 0.5), atol=1e-4)  # a hundredth forwards, over a fiftieth
    with pytest.raises(ValueError, match="guided by a contrast run"):
        CameraView(SETTINGS, vessels.target)
    with pytest.raises(ValueError, match="5 tokens and 8 encoder outputs"):
        view.look(WireReading(np.zeros((4, 3), np.float32), first[:2].reshape(1, 2), np.zeros(8, np.float32), 1.0))


@pytest.mark.parametrize("variant", VARIANTS)
def test_reading_is_that_of_the_predictor(variant: str) -> None:
    network = perception_network(variant)
    images = [image_of(wavy_wire(seed)) for seed in (0, 1)]
    readings = network(images)
    assert len(readings) == 2
    for reading, predicted in zip(readings, network.predictor.batch(images), strict=True):
        assert reading.tokens.shape == (network.tokens, 3)
        assert reading.encoded.shape == (network.encoded,)
        assert 0 <= reading.confidence <= 1
        assert np.allclose(reading.tokens[-1, 0], 1.0, atol=1e-5)  # knots are shares of the length
        if predicted.tokens is not None and not predicted.inverted:
            assert np.allclose(256 * reading.points[0] - 0.5, predicted.tip_px, atol=1e-2)


def near(picture: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    """Rows and columns of the right half's pixels of a colour."""
    return np.argwhere((picture[:, SIDE_PX:] == colour).all(axis=2))


def test_mark_and_tip_are_drawn_where_they_are() -> None:
    network, image = perception_network(), image_of(wavy_wire(0))
    picture = picture_of_moment(image, network, (0.25, 0.75))
    assert picture.shape == (SIDE_PX, 2 * SIDE_PX, 3)
    left = picture[:, :SIDE_PX].astype(int)
    assert (left == left[..., :1]).all()  # grey
    assert np.abs(left[..., 0] - image).mean() < 3
    mark = near(picture, (0, 190, 255))
    np.testing.assert_allclose(mark.mean(axis=0), (0.75 * SIDE_PX, 0.25 * SIDE_PX), atol=2)
    tip = near(picture, (60, 255, 60))
    x, y = SIDE_PX * network([image])[0].points[0]
    np.testing.assert_allclose(tip.mean(axis=0), (y, x), atol=3)


def shown(count: int = 6, held_out: int = 2) -> WirePictures:
    curves = [wavy_wire(seed) for seed in range(count)]
    pictures = np.stack([picture_of(image_of(curve), 64, 256).pixels for curve in curves])
    shares = np.stack([resample((curve + 0.5) / 256, count=CURVE_POINTS) for curve in curves])
    return WirePictures(pictures, shares, np.arange(count) >= count - held_out)


def predictor() -> Predictor:
    return perception_network().predictor


def test_weights_go_on_from_where_they_are_and_the_same_seed_gives_the_same(tmp_path: Path) -> None:
    before = {name: value.clone() for name, value in predictor().network.state_dict().items()}
    epochs, results = [], []
    for run in ("one", "other"):
        tuned, outcome = fine_tune(
            predictor(), shown(), "ordered", 1, folder=tmp_path / run, seed=3,
            progress=lambda now: epochs.append(now.epoch),
        )  # fmt: skip
        results.append((tuned.network.state_dict(), outcome))
    (weights, outcome), (twin, _) = results
    assert outcome["images"] == 6
    assert outcome["tip_px_before"] == pytest.approx(errors(predictor(), shown())["tip_px"])
    assert set(outcome) >= {"cpu_min", "tip_px_after", "median_mean_px_after"}
    assert epochs == [1, 1]
    assert any(not torch.equal(weights[name], before[name]) for name in before)
    assert all(torch.equal(weights[name], twin[name]) for name in weights)


def test_a_network_of_maps_is_refused() -> None:
    with pytest.raises(ValueError, match="grey levels, got one that reads maps"):
        PerceptionNetwork(Predictor(perception_network().predictor.network, source_px=256, input="maps"))
