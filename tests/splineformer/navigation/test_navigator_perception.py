"""The navigator's perception: features of several episodes at once, of one camera or two, and what it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splineformer.navigation.camera_view import CameraView
from splineformer.navigation.navigator_perception import EpisodeView, NavigatorPerception, NavigatorPerceptionSettings
from splineformer.navigation.perception import PerceptionNetwork
from splineformer.navigation.space_view import SIZE
from splineformer.navigation.vessel_map import VesselMap
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


def test_a_view_remembers_the_last_two_actions() -> None:
    settings = NavigatorPerceptionSettings(tokens=5, encoded=8, guided=False)
    view = EpisodeView(settings, list, {"a": (0.9, 0.19)})
    actions = [STILL, np.array([0.5, -0.5]), np.array([1.0, 0.25])]
    last = [view.look([straight((0.19, 0.6))], action)[-4:] for action in actions]
    assert [one.tolist() for one in last] == [[0, 0, 0, 0], [0.5, -0.5, 0, 0], [1, 0.25, 0.5, -0.5]]


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
    settings = settings_of(network)
    with pytest.raises(ValueError, match="camera a: give"):
        EpisodeView(settings, list, {"b": (0.5, 0.5)})
    with pytest.raises(ValueError, match="take the one that it was trained with"):
        NavigatorPerception(settings, perception_network("published"))
    with pytest.raises(ValueError, match="each once"):
        replace(settings, cameras=("a", "a"))
    with pytest.raises(ValueError, match="by two cameras and their contrast"):
        replace(settings, guided=True, space=True)
    both = replace(settings, cameras=("a", "b"), guided=True)
    with pytest.raises(ValueError, match="guided by a contrast run"):
        EpisodeView(both, list, {"a": (0.5, 0.5), "b": (0.5, 0.5)})
    with pytest.raises(ValueError, match="give the map that both contrast runs make"):
        EpisodeView(replace(both, space=True), list, {"a": (0.5, 0.5), "b": (0.5, 0.5)})
    assert replace(both, space=True).size == both.size + SIZE
