"""Image input: sizes, depths and shapes of images, and pixels as shares of the side."""

from __future__ import annotations

import math

import numpy as np
import pytest

from guide3d.reading.grey_image import grey_image
from splineformer.image_input import picture_of, pixels_of_shares, shares_of_pixels
from tests.splineformer.curves import image_of, wavy_wire


def test_shares_and_pixels() -> None:
    shares = shares_of_pixels(np.array([[-0.5, 255.5], [127.5, 0.0]]), (256, 256))
    assert np.allclose(shares, [[0, 1], [0.5, 0.5 / 256]])
    assert np.allclose(pixels_of_shares(shares, (256, 256)), [[-0.5, 255.5], [127.5, 0.0]])


def test_areas_are_averaged_on_the_way_down() -> None:
    image = np.zeros((128, 128), np.uint8)
    image[:, 1::2] = 200
    picture = picture_of(image, 64, 128)
    assert (picture.pixels == 100).all()
    assert (picture.side_px, picture.warnings) == (128.0, ())
    assert picture.pixels.dtype == np.uint8


def test_images_of_the_networks_size_stay_as_they_are() -> None:
    image = image_of(wavy_wire(0, 64), 64)
    assert np.array_equal(picture_of(image, 64, 64).pixels, image)
    assert np.array_equal(picture_of(np.stack([image] * 3, -1), 64, 64).pixels, image)
    assert np.array_equal(picture_of(np.stack([image] * 4, -1), 64, 64).pixels, image)


@pytest.mark.parametrize("shape", [(64, 256), (256, 64)])
def test_shorter_sides_are_filled_up_with_black(shape: tuple[int, int]) -> None:
    picture = picture_of(np.random.default_rng(0).integers(100, 200, shape).astype(np.uint8), 64, 256)
    rows, columns = (math.ceil(64 * side / 256) for side in shape)
    assert (picture.pixels[:rows, :columns] > 0).all()
    assert not picture.pixels[rows:].any()
    assert not picture.pixels[:, columns:].any()
    assert picture.warnings == (f"{shape[1]} x {shape[0]} px instead of 256 x 256",)


def test_deep_images_have_the_grey_levels_that_guide3d_gives_them() -> None:
    levels = np.linspace(1000.0, 3000.0, 128 * 128).reshape(128, 128)
    levels[1, 1] = 1e9  # one hot pixel
    picture = picture_of(levels, 128, 128)
    assert np.array_equal(picture.pixels, grey_image(levels).pixels)
    assert picture.pixels[64, 0] == pytest.approx(235 * 2000 / 3000, abs=4)
    assert picture.warnings[0].startswith("grey values of 24.6211 to 29")
    flat = np.zeros((128, 128))
    flat[1, 1] = 1.0  # less than the tails: both ends are taken as they are
    assert picture_of(flat, 128, 128).pixels[1, 1] == 235
