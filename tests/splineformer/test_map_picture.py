"""Pictures of maps: places and tips survive the reduction; negatives and other shapes are read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from splineformer.map_picture import TIP, WHITE, WIRE, map_picture, picture_by_reader, reduced


@dataclass(frozen=True)
class DarkMaps:
    """Maps that call dark pixels wire."""

    wire: np.ndarray
    tip: np.ndarray
    catheter: np.ndarray


class DarkReader:
    """Reads dark pixels as wire, its topmost row as tip."""

    def maps(self, image: np.ndarray) -> DarkMaps:
        wire = (image < 60).astype(np.float32)
        tip = wire.copy()
        tip[np.flatnonzero(wire.any(axis=1))[:1].max(initial=-1) + 1 :] = 0
        return DarkMaps(wire, tip, np.zeros_like(wire))


def lined(height: int = 256, width: int = 256) -> np.ndarray:
    """A bright image with a dark vertical line of 4 px from row 40 on."""
    image = np.full((height, width), 180, np.uint8)
    image[40:, 100:104] = 20
    return image


def test_levels_of_wire_and_tip() -> None:
    wire, tip = np.array([[0, 255, 255]], np.uint8), np.array([[0, 0, 255]], np.uint8)
    assert map_picture(wire, tip).tolist() == [[WHITE, WHITE - WIRE, WHITE - WIRE - TIP]]


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


def test_what_is_no_image_is_refused() -> None:
    with pytest.raises(ValueError, match="no contrast"):
        picture_by_reader(np.full((200, 200), 9, np.uint8), 64, DarkReader())
