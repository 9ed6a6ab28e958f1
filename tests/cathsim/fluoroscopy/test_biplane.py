"""Two-camera fluoroscopes: wires, devices, the environment that observes through them."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import ndimage

from cathsim.fluoroscopy import BiplaneFluoroscope, Radiograph, catheter_material, guide3d_pair, radiograph, scene
from tests.cathsim.fluoroscopy.ball import CENTRE as BALL
from tests.cathsim.fluoroscopy.ball import RADIUS, ball_grid

PHANTOM = SimpleNamespace(grid=ball_grid(), bounds=np.array([[-0.03] * 3, [0.03] * 3]), hash="a ball for the tests")
NOTHING = np.zeros((0, 3))


def arc_wire(spacing=0.002, start=0.0):
    """A wire on a slanted arc from a distance (m) along it on; the truth in closed form."""
    angle = np.arange(start, 0.12, spacing) / 0.045
    return np.column_stack((0.045 * np.cos(angle), 0.01 * np.sin(2 * angle), 0.045 * np.sin(angle) - 0.01))


@pytest.fixture(scope="module")
def fluoroscope():
    return BiplaneFluoroscope.of(PHANTOM, size=512)


@pytest.fixture(scope="module")
def small():
    return BiplaneFluoroscope.of(PHANTOM, size=96)


@pytest.mark.parametrize("name", ["a", "b"])
def test_image_and_mask_lie_on_the_projected_wire(fluoroscope, name):
    camera = fluoroscope.cameras[name]
    truth = camera.distortion.distort(camera.projector.project(arc_wire(1e-4)))
    frame, empty = (fluoroscope.render(points)[name] for points in (arc_wire(), NOTHING))
    tangent = np.gradient(truth, axis=0)
    normal = np.column_stack((-tangent[:, 1], tangent[:, 0])) / np.linalg.norm(tangent, axis=1, keepdims=True)
    across = np.linspace(-6, 6, 121)
    keep = slice(100, -100, 10)
    at = truth[keep, None] + across[:, None] * normal[keep, None]
    for picture, bound in ((1 - ((frame.image + 0.5) / (empty.image + 0.5)) ** 2, 0.1), (frame.mask * 1.0, 0.3)):
        profile = ndimage.map_coordinates(picture, [at[..., 1], at[..., 0]], order=1)
        profile = np.where(profile > 0.05, profile, 0)
        offset = (profile * across).sum(axis=1) / profile.sum(axis=1)
        assert np.abs(offset).mean() < bound
    np.testing.assert_array_equal(np.abs(fluoroscope.centreline(arc_wire(), name)[0] - truth[0]).round(6), 0)
    assert ndimage.label(frame.mask, np.ones((3, 3)))[1] == 1


def test_same_seed_same_bits_and_cameras_do_not_disturb_each_other(small, fluoroscope):
    wire = arc_wire()
    first, again = small.render(wire, 5), small.render(wire, np.random.default_rng(5))
    for name in small.names:
        np.testing.assert_array_equal(first[name].image, again[name].image)
        np.testing.assert_array_equal(first[name].mask, again[name].mask)
        np.testing.assert_array_equal(first[name].image, small.render(wire, 5, only=[name])[name].image)
    five, six = (fluoroscope.render(wire, seed)["a"].image for seed in (5, 6))
    assert (five != six).mean() > 0.5
    assert (first["a"].mask != first["b"].mask).any()
    np.testing.assert_array_equal(small.render(wire)["a"].image, small.render(wire)["a"].image)


@pytest.mark.parametrize("expected", [0.4, 9.0, 300.0])
def test_counts_are_poisson(expected):
    camera = guide3d_pair(np.zeros(3), 128)[0]
    scale = camera.detector.photons / camera.detector.white(128, 128)
    # one photon is one unit of squared grey: white at 255 x 255 photons
    detector = replace(camera.detector, photons=scale * 255**2, video_noise=0.0, screen_blur=0.0)
    field = np.full((128, 128), expected, np.float32)
    still = Radiograph(field, np.zeros_like(field))
    one = BiplaneFluoroscope([replace(camera, detector=detector)], [still])
    images = [one.render(NOTHING, seed)["a"].image.astype(float) for seed in range(8)]
    counts = np.square(np.stack(images))  # rounded to whole grey levels
    if expected < 1:
        assert (counts == 0).mean() == pytest.approx(np.exp(-expected), abs=0.01)
        return
    exact = np.random.default_rng(0).poisson(expected, (8, 128, 128))
    shown = np.square(np.rint(np.sqrt(exact)))
    assert counts.mean() == pytest.approx(shown.mean(), rel=0.01)
    assert counts.var() == pytest.approx(shown.var(), rel=0.04)


def test_contrast_darkens_and_air_brightens_the_lumen():
    camera = guide3d_pair(np.zeros(3), 96)[0]
    at = np.rint(camera.pixels(BALL[None])[0]).astype(int)[::-1]
    levels = {}
    for filling in ("air", "fluid", "contrast"):
        still = radiograph(PHANTOM.grid, camera, scene("bath", filling))
        levels[filling] = still.primary[tuple(at)] / np.median(still.primary[20:76, 20:76])
    assert levels["air"] > 1.2 * levels["fluid"] > 1.6 * levels["contrast"]
    # Beer and Lambert through the middle of the ball
    ratio = np.exp(-2 * RADIUS * (scene("bath", "contrast").filling))
    empty = radiograph(PHANTOM.grid, camera, replace(scene("bath"), wall=0.0))
    filled = radiograph(PHANTOM.grid, camera, replace(scene("bath", "contrast"), wall=0.0))
    corner = np.s_[10:20, 40:60]
    gain = filled.primary[corner].mean() / empty.primary[corner].mean()
    assert filled.primary[tuple(at)] / empty.primary[tuple(at)] / gain == pytest.approx(ratio, rel=0.06)


def test_bad_input_is_refused(small):
    camera = guide3d_pair(np.zeros(3), 64)[0]
    for call, message in (
        (lambda: BiplaneFluoroscope.of(PHANTOM, size=8), "16 to 4096 px"),
        (lambda: BiplaneFluoroscope.of(PHANTOM, size=32, surroundings="moon"), "unknown scene"),
        (lambda: small.render(arc_wire(), only=["c"]), "unknown camera 'c'"),
        (lambda: small.render([[np.nan, 0, 0], [0, 0, 0]]), "not finite"),
        (lambda: small.render([[0, 0, 0], [0, 0, 5.0], [0, -5.0, 5.0]]), "in front of the X-ray source"),
        (lambda: BiplaneFluoroscope([camera, camera], []), "names of their own"),
        (lambda: BiplaneFluoroscope([camera], []), "a radiograph a camera"),
    ):
        with pytest.raises(ValueError, match=message):
            call()


SIZE = 512


@pytest.fixture(scope="module")
def in_air() -> BiplaneFluoroscope:
    """Of nothing but air: every pixel expects as many photons, and none are scattered."""
    cameras = guide3d_pair(np.zeros(3), SIZE)
    stills = [Radiograph(np.full((SIZE, SIZE), 500.0, np.float32), np.zeros((SIZE, SIZE), np.float32)) for _ in cameras]
    tube = catheter_material(0.835e-3, 0.6e-3, wall=170.0, marker=1430.0, marker_length=4e-3)
    return BiplaneFluoroscope(cameras, stills, catheter=tube)


def depth(image: np.ndarray) -> np.ndarray:
    """Optical depth in an image without noise, whose grey levels are the square root of the light."""
    return -2 * np.log(image / image.max())


def test_without_a_catheter_it_is_the_bare_wire_bit_for_bit(in_air: BiplaneFluoroscope) -> None:
    bare, both = in_air.render(arc_wire(), 3), in_air.render_devices(arc_wire(), NOTHING, 3)
    for name in in_air.names:
        assert np.array_equal(bare[name].image, both[name].image)
        assert np.array_equal(bare[name].mask, both[name].mask)
        assert np.array_equal(bare[name].mask, both[name].mask_wire)
        assert not both[name].mask_catheter.any()


@pytest.mark.parametrize("name", ["a", "b"])
def test_attenuation_of_both_adds(in_air: BiplaneFluoroscope, name: str) -> None:
    wire, catheter = arc_wire(), arc_wire(start=0.04)
    both, inner, outer = (
        in_air.render_devices(*pair)[name] for pair in ((wire, catheter), (wire, NOTHING), (NOTHING, catheter))
    )
    assert depth(both.image) == pytest.approx(depth(inner.image) + depth(outer.image), abs=0.05)
    assert depth(both.image).max() > depth(inner.image).max() + 0.02
    assert np.array_equal(both.mask, both.mask_wire | both.mask_catheter)
    assert np.array_equal(both.mask_catheter, outer.mask)
    ahead = both.mask_wire > both.mask_catheter
    inside = (both.mask_wire == 1) & (both.mask_catheter == 1)
    assert ahead.any()
    assert inside.sum() > ahead.sum()


def test_the_marker_is_at_the_tip_alone(in_air: BiplaneFluoroscope) -> None:
    image = in_air.render_devices(NOTHING, arc_wire(start=0.04))["a"].image
    dark = np.argwhere(depth(image) > 0.4)
    camera = in_air.cameras["a"]
    end = arc_wire(start=0.04)[0]
    tip = camera.pixels(end[None])[0]
    assert len(dark) > 5
    assert np.linalg.norm(dark[:, ::-1] - tip, axis=1).max() < 4.5e-3 * camera.projector.pixels_per_metre(end)


def test_a_fluoroscope_without_the_material_says_how_to_have_it(in_air: BiplaneFluoroscope) -> None:
    cameras = list(in_air.cameras.values())
    still = Radiograph(np.ones((SIZE, SIZE), np.float32), np.zeros((SIZE, SIZE), np.float32))
    with pytest.raises(ValueError, match="with_catheter"):
        BiplaneFluoroscope(cameras, [still, still]).render_devices(NOTHING, arc_wire())


NAMES = ("image_a", "mask_a", "image_b", "mask_b")


def test_observations_match_their_spaces_and_repeat(make_env):
    env = make_env(cameras="guide3d", observation=(*NAMES, "image"), image_size=64)
    runs = []
    for _ in range(2):
        observation, _ = env.reset(seed=3)
        steps = [observation] + [env.step(np.array([1.0, 0.4]))[0] for _ in range(4)]
        runs.append(steps)
    for one, other in zip(*runs, strict=True):
        assert env.observation_space.contains(one)
        for name in one:
            np.testing.assert_array_equal(one[name], other[name])
    first, second = runs[0][0], runs[0][1]
    assert (first["image_a"] != second["image_a"]).mean() > 0.3  # noise is new in every step
    assert set(np.unique(first["mask_a"])) == {0, 255}
    observation, _ = env.reset(seed=4)
    assert (observation["image_a"] != first["image_a"]).mean() > 0.3


def test_log_holds_every_camera(make_env, tmp_path: Path):
    pytest.importorskip("mcap")
    from pipeline.episodes import EpisodeReader
    from pipeline.recording.record import record_episode

    env = make_env(cameras="guide3d", observation="tip", image_size=48, max_steps=3)
    path = tmp_path / "episode.mcap"
    record_episode(env, lambda observation, info: np.array([1.0, 0.0]), path, seed=0, operator="test")
    with EpisodeReader(path) as log:
        assert set(log.cameras) == {"frontal", "a", "b"}
        arrays, info = log.load_arrays(), log.info
        np.testing.assert_allclose(log.camera("b").P, env.biplane.fluoroscope.cameras["b"].projector.P)
    assert arrays["image/a"].shape == arrays["mask/b"].shape == (4, 48, 48)
    np.testing.assert_array_equal(arrays["image/a"][-1], env.biplane.frame("a").image)
    np.testing.assert_array_equal(arrays["mask/b"][-1], env.biplane.frame("b").mask)
    assert info.configuration["cameras"]["a"]["distortion"]["pincushion"] > 0
