"""Two images to a wire in space: drawn views of synthetic scenes, whose wire is known."""

import functools
import re

import numpy as np
import pytest

from guide3d import read_pair
from guide3d.geometry.distortion import Distortion
from guide3d.geometry.metrics import curve_metrics
from guide3d.geometry.polyline import distances_to
from guide3d.reading.image_reading import ImageReading, read
from guide3d.reading.pair_reading import combine
from guide3d.reconstruction.synthetic_scene import SyntheticScene, scenes
from tests.guide3d.reading.drawn_maps import DarkLineReader, DrawnReader, clutter, maps_of, picture

SCENES = list(scenes(4, seed=77))
READER = DrawnReader([])


def _pictures(scene: SyntheticScene) -> list[np.ndarray]:
    """Both views, which `READER` can read afterwards."""
    for number, points in enumerate(scene.points):
        maps = maps_of(points, gaps=((0.6 * len(points), 0.6 * len(points) + 40.0),), tip=0.8)
        READER.drawn.append(clutter(maps, seed=number))
    return [picture(maps) for maps in READER.drawn[-2:]]


@pytest.fixture(scope="module")
def arch() -> tuple[SyntheticScene, list[np.ndarray], list[ImageReading]]:
    pictures = _pictures(SCENES[0])
    return SCENES[0], pictures, [read(image, READER) for image in pictures]


@pytest.mark.parametrize("scene", SCENES, ids=[scene.kind for scene in SCENES])
def test_the_wire_in_space_is_found(scene: SyntheticScene) -> None:
    reading = read_pair(*_pictures(scene), scene.cameras, reader=READER)
    errors = curve_metrics(scene.curve_mm, reading.curve_mm)
    assert errors["chamfer"] < 0.8
    assert errors["mete"] < 1.5
    assert reading.accepted
    assert reading.residual_px < 2.0
    assert reading.covariance_mm2.shape == (len(reading.curve_mm), 3, 3)
    assert np.linalg.eigvalsh(reading.covariance_mm2).min() > 0
    off = distances_to(scene.curve_mm, reading.curve_mm)
    assert 0.3 < np.sqrt(np.mean(reading.sd_mm**2) / np.mean(off**2)) < 6


def test_the_other_view_decides_which_end_is_the_tip(arch: tuple[SyntheticScene, list, list[ImageReading]]) -> None:
    scene, _, views = arch
    # the wrong reading comes first: the curve walked from its other end
    a, b = (ImageReading(v.points_px, v.confidence, v.sd_px, 0.0, list(v.candidates), []) for v in views)
    a.candidates.sort(key=lambda one: -np.hypot(*(one.points_px[0] - scene.points[0][0])))
    reading = combine([a, b], scene.cameras)
    assert np.hypot(*(reading.views[0].points_px[0] - scene.points[0][0])) < 8.0


def test_swapped_cameras_are_said(arch: tuple[SyntheticScene, list, list[ImageReading]]) -> None:
    scene, _, views = arch
    reading = combine(views, scene.cameras[::-1])
    assert any("the cameras look swapped" in message for message in reading.messages)


def test_a_camera_of_another_view_is_said(arch: tuple[SyntheticScene, list, list[ImageReading]]) -> None:
    scene, _, views = arch
    other = SCENES[3]
    try:
        reading = combine([views[0], read(_pictures(other)[1], READER)], scene.cameras)
    except ValueError as error:
        assert "nothing in common" in str(error) or "in common" in str(error)  # noqa: PT017
    else:
        assert not reading.accepted
        assert any("do not show one wire" in m or "poorly" in m or "swapped" in m for m in reading.messages)


def test_raw_images_are_undistorted_and_undistorted_ones_are_recognised() -> None:
    scene = SCENES[0]

    def distort(points: np.ndarray, sign: float) -> np.ndarray:
        away = (points - 511.5) / 512
        return np.asarray(points + sign * (14.0 * (away**2).sum(axis=1, keepdims=True) * away + [6.0, 18.0]))

    maps = tuple(Distortion.of_function(functools.partial(distort, sign=sign), 1024) for sign in (1.0, -1.0))
    moved = [distort(points, sign) for points, sign in zip(scene.points, (1.0, -1.0), strict=True)]
    raw = [picture(maps_of(points, tip=0.0)) for points in moved]
    plain = [picture(maps_of(points, tip=0.0)) for points in scene.points]
    residuals = {}
    for frame, images in (("raw", raw), ("undistorted", plain)):
        reading = read_pair(*images, scene.cameras, distortions=maps, reader=DarkLineReader())
        assert curve_metrics(scene.curve_mm, reading.curve_mm)["chamfer"] < 0.8
        assert any("undistorted already" in message for message in reading.messages) == (frame == "undistorted")
        residuals[frame] = reading.residual_px
    wrong = read_pair(*raw, scene.cameras, distortions=maps, frame="undistorted", reader=DarkLineReader())
    assert wrong.residual_px > 2.0 * residuals["raw"]


def test_a_wire_that_one_image_hardly_shows_is_refused() -> None:
    scene = SCENES[0]
    pictures = _pictures(scene)
    READER.drawn.append(maps_of(scene.points[1], weak=((200, 5000, 0.4),)))
    reading = read_pair(pictures[0], picture(READER.drawn[-1]), scene.cameras, reader=READER)
    assert reading.residual_px < 2.0
    assert not reading.accepted
    assert re.fullmatch(r"\d\d% of the curve in image B is guessed, more than 33%: .*", reading.refusal)
    assert reading.refusal in reading.messages


def test_bad_input_is_one_sentence(arch: tuple[SyntheticScene, list[np.ndarray], list]) -> None:
    scene, pictures, _ = arch
    empty = np.random.default_rng(0).integers(160, 200, (1024, 1024), dtype=np.uint8)
    with pytest.raises(ValueError, match="image B: no wire was found"):
        read_pair(pictures[0], empty, scene.cameras, reader=READER)
    with pytest.raises(ValueError, match="image A has 512 x 512 px, its camera A 1024 x 1024"):
        read_pair(pictures[0][:512, :512], pictures[1], scene.cameras, reader=READER)
    with pytest.raises(ValueError, match="expected a frame among auto, raw, undistorted"):
        read_pair(*pictures, scene.cameras, frame="round", reader=READER)
    with pytest.raises(ValueError, match="raw images need the distortions"):
        read_pair(*pictures, scene.cameras, frame="raw", reader=READER)
    with pytest.raises(ValueError, match="two different images"):
        read_pair(pictures[0], pictures[0].copy(), scene.cameras, reader=READER)
