"""What a network takes from an image, and where it looks."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from guide3d.reading.grey_image import grey_image
from splineformer.attention import attention_map
from splineformer.build import SIZES, VARIANTS, size_of
from splineformer.image_input import picture_of
from splineformer.map_picture import WHITE, picture_by_reader, reduced
from splineformer.predictor import Predictor
from tests.splineformer.curves import image_of, levels, network, wavy_wire


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


class DarkReader:
    """Reads dark pixels as wire, its topmost row as tip."""

    def maps(self, image: np.ndarray) -> Any:
        wire = (image < 60).astype(np.float32)
        tip = wire.copy()
        tip[np.flatnonzero(wire.any(axis=1))[:1].max(initial=-1) + 1 :] = 0
        return SimpleNamespace(wire=wire, tip=tip, catheter=np.zeros_like(wire))


def lined(height: int = 256, width: int = 256) -> np.ndarray:
    """A bright image with a dark vertical line of 4 px from row 40 on."""
    image = np.full((height, width), 180, np.uint8)
    image[40:, 100:104] = 20
    return image


@pytest.mark.parametrize("side", [256, 250])
def test_a_wire_stays_in_its_place_and_a_tip_is_seen(side: int) -> None:
    wire, tip = np.zeros((2, side, side), np.float32)
    wire[:, 101:107] = 1.0
    tip[50, 103] = 1.0
    picture = reduced(wire, tip, 64)
    dark = WHITE - picture.astype(float)
    assert np.average(np.arange(64), weights=dark[20]) == pytest.approx((103.5 + 0.5) * 64 / side - 0.5, abs=0.05)
    row, column = np.unravel_index(picture.argmin(), picture.shape)
    assert (row, column) == (int(50.5 * 64 / side), int(103.5 * 64 / side))


def test_an_image_of_another_shape_lies_in_the_corner() -> None:
    picture = picture_by_reader(lined(256, 512), 64, DarkReader())
    assert picture.side_px == 512
    assert not picture.inverted
    assert (picture.pixels[40:] == 255).all()  # below the image
    assert picture.pixels[10, 12] < 180


def test_a_negative_is_inverted() -> None:
    picture = picture_by_reader(255 - lined(), 128, DarkReader())
    assert picture.inverted
    plain = picture_by_reader(lined(), 128, DarkReader())
    assert not plain.inverted
    assert np.array_equal(picture.pixels, plain.pixels)


@pytest.mark.parametrize("variant", VARIANTS)
def test_attention_map(variant: str) -> None:
    model = network(variant)
    weights, lengths = model.attention(levels(2))
    assert torch.allclose(weights.sum(-1), torch.ones(weights.shape[:3]), atol=1e-5)
    assert (lengths <= weights.shape[2]).all()
    predictor = Predictor(model, source_px=256)
    seen = attention_map(predictor, image_of(wavy_wire(0)))
    assert seen.shape == (256, 256)
    assert 0 <= seen.min() < seen.max() <= 1
    assert attention_map(predictor, image_of(wavy_wire(0))[:128]).shape == (128, 256)
    with pytest.raises(ValueError, match="expected an image of at least 64 x 64 px"):
        attention_map(predictor, np.zeros((4, 4)))


def test_unknown_variant_and_size() -> None:
    with pytest.raises(ValueError, match="published, ordered"):
        size_of("other", "desk")
    with pytest.raises(ValueError, match="thesis, desk, smoke"):
        size_of("ordered", "huge")
    assert set(SIZES) == set(VARIANTS)
