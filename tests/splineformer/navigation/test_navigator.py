"""The navigator: readings of a frozen network, the contrast run's ways, views, cloning, and files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from splineformer.build import VARIANTS, build, size_of
from splineformer.image_input import picture_of
from splineformer.navigation.camera_view import AGO, RAYS, WAY_ARCS, CameraView, ViewSettings
from splineformer.navigation.cloning import CloningSettings, Episode, clone
from splineformer.navigation.navigator import Navigator, NavigatorSettings
from splineformer.navigation.perception import CURVE_POINTS, Reader, Reading
from splineformer.navigation.vessel_map import VesselMap, lumen_of_run
from splineformer.predictor import Predictor
from tests.damaged_files import refusals
from tests.splineformer.curves import image_of, wavy_wire


def reader(variant: str = "ordered") -> Reader:
    torch.manual_seed(0)
    return Reader(Predictor(build(size_of(variant, "smoke")), source_px=256))


def settings_of(eye: Reader, **changed: object) -> NavigatorSettings:
    return replace(NavigatorSettings(tokens=eye.tokens, memory=eye.memory, hidden=16), **changed)  # type: ignore[arg-type]


def bend() -> np.ndarray:
    """A lumen like an L: up along the left side, then to the right."""
    lumen = np.zeros((64, 64))
    lumen[8:60, 8:16] = lumen[8:16, 8:60] = 1.0
    return lumen


def straight(tip: tuple[float, float], length: float = 0.4) -> Reading:
    """A wire that comes from below and ends at a tip."""
    points = np.array(tip) + np.linspace(0, length, CURVE_POINTS)[:, None] * (0.0, 1.0)
    return Reading(np.zeros((5, 3), np.float32), points.astype(np.float32), np.zeros(8, np.float32), 0.9)


SETTINGS = ViewSettings(tokens=5, memory=8, guided=True)


@pytest.mark.parametrize("variant", VARIANTS)
def test_reading_is_that_of_the_predictor(variant: str) -> None:
    eye = reader(variant)
    images = [image_of(wavy_wire(seed)) for seed in (0, 1)]
    readings = eye(images)
    assert len(readings) == 2
    for reading, told in zip(readings, eye.predictor.batch(images), strict=True):
        assert reading.tokens.shape == (eye.tokens, 3)
        assert reading.memory.shape == (eye.memory,)
        assert 0 <= reading.confidence <= 1
        assert np.allclose(reading.tokens[-1, 0], 1.0, atol=1e-5)  # knots are shares of the length
        if told.tokens is not None and not told.inverted:
            assert np.allclose(256 * reading.points[0] - 0.5, told.tip_px, atol=1e-2)


@pytest.mark.parametrize("variant", VARIANTS)
def test_memory_is_the_encoders(variant: str) -> None:
    eye = reader(variant)
    image = image_of(wavy_wire(0))
    reading = eye([image])[0]
    levels = torch.from_numpy(picture_of(image, 64, 256).pixels.astype(np.float32))[None, None]
    with torch.no_grad():
        memory = eye.network.read(levels).features
    assert np.allclose(reading.memory[: len(reading.memory) // 2], memory[0].mean(0).numpy(), atol=1e-5)
    assert not eye.network.training


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
    with pytest.raises(ValueError, match="5 tokens and a memory of 8"):
        view.look(Reading(np.zeros((4, 3), np.float32), first[:2].reshape(1, 2), np.zeros(8, np.float32), 1.0))


def drawn_episodes(settings: NavigatorSettings, count: int = 12) -> list[Episode]:
    """Episodes in which the first number of a look tells the translation, and the one before it the rotation."""
    generator = np.random.default_rng(3)
    found = []
    for _ in range(count):
        length = int(generator.integers(6, 15))
        looks = generator.uniform(-1, 1, (length, settings.size)).astype(np.float32)
        before = np.concatenate(([0.0], looks[:-1, 0]))
        actions = np.stack((0.8 * looks[:, 0], 0.8 * before), axis=1).astype(np.float32)
        found.append(Episode(looks, actions, np.zeros((length, 0), np.float32), True))
    return found


def test_cloning_learns_what_was_done_and_what_was_before() -> None:
    eye = reader()
    settings = settings_of(eye, guided=False, hidden=32)
    episodes = drawn_episodes(settings, 40)
    navigator = Navigator(settings, eye)
    losses = clone(navigator, episodes, CloningSettings(epochs=40, noise=0.0, weight_decay=0.0))
    assert losses[-1] < 0.25 * losses[0]
    few = clone(Navigator(settings, eye), episodes, CloningSettings(epochs=2, updates=17))
    assert len(few) == 4  # of five batches each
    again = Navigator(settings, eye)
    assert clone(again, episodes, CloningSettings(epochs=40, noise=0.0, weight_decay=0.0)) == losses


def test_bad_episodes_are_refused() -> None:
    eye = reader()
    settings = settings_of(eye)
    good = drawn_episodes(settings, 1)[0]
    with pytest.raises(ValueError, match="no episode"):
        clone(Navigator(settings, eye), [], CloningSettings())
    with pytest.raises(ValueError, match=f"looks of {settings.size}"):
        clone(Navigator(settings, eye), [replace(good, looks=good.looks[:, :-1])], CloningSettings())
    with pytest.raises(ValueError, match="must be finite"):
        replace(good, looks=np.full_like(good.looks, np.nan))
    with pytest.raises(ValueError, match="as many looks as actions"):
        replace(good, actions=good.actions[:-1])
    with pytest.raises(ValueError, match="epochs must be greater than or equal to 1, got 0"):
        CloningSettings(epochs=0)


def test_controller_looks_once_a_decision_and_remembers() -> None:
    eye = reader()
    settings = settings_of(eye, action_repeat=3)
    navigator = Navigator(settings, eye, seed=1)
    clone(navigator, drawn_episodes(settings), CloningSettings(epochs=1))
    vessels = {"a": VesselMap(bend(), (0.9, 0.19))}
    asked = []

    def images() -> list[np.ndarray]:
        asked.append(1)
        return [image_of(wavy_wire(0))]

    def play() -> np.ndarray:
        steer = navigator.controller(images, {"a": (0.9, 0.19)}, vessels)
        return np.array([steer() for _ in range(7)])

    actions = play()
    assert len(asked) == 3
    assert (np.abs(actions) <= 1).all()
    assert np.array_equal(actions[0], actions[2])
    assert not np.array_equal(actions[0], actions[3])  # the image is the same, what came before is not
    assert np.array_equal(play(), actions)
    with pytest.raises(ValueError, match="camera a: give"):
        navigator.controller(images, {"b": (0.5, 0.5)})


def test_file_keeps_the_policy_and_names_the_network_it_needs(tmp_path: Path) -> None:
    eye = reader()
    settings = settings_of(eye, cameras=("a", "b"))
    navigator = Navigator(settings, eye)
    clone(navigator, drawn_episodes(settings, 4), CloningSettings(epochs=2))
    navigator.save(tmp_path / "navigator.pt", episodes=4)
    back = Navigator.load(tmp_path / "navigator.pt", eye)
    looks = drawn_episodes(settings, 1)[0].looks
    assert back.settings == settings
    assert np.array_equal(back.act(looks)[0], navigator.act(looks)[0])
    with pytest.raises(ValueError, match="take the one that the navigator was trained with"):
        Navigator.load(tmp_path / "navigator.pt", reader("published"))
    (tmp_path / "navigator.pt").write_bytes(b"x")
    with pytest.raises(ValueError, match="damaged or no network"):
        Navigator.load(tmp_path / "navigator.pt", eye)
    with pytest.raises(FileNotFoundError):
        Navigator.load(tmp_path / "none.pt", eye)
    with pytest.raises(ValueError, match="each once"):
        NavigatorSettings(cameras=("a", "a"))


def test_a_wrong_bit_is_refused(tmp_path: Path) -> None:
    eye = reader()
    Navigator(settings_of(eye), eye).save(tmp_path / "navigator.pt")
    messages = refusals(tmp_path / "navigator.pt", lambda: Navigator.load(tmp_path / "navigator.pt", eye))
    assert all("navigator.pt is damaged or no network" in message for message in messages)
