"""Drawn X-ray images of any size, width of the wire and shape of its tip are read alike by the shipped reader."""

from __future__ import annotations

import numpy as np
import pytest

from guide3d import read
from guide3d.opencv import cv2
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy, RandomImage
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from tests.guide3d.reading.drawn_maps import bent, within
from tests.guide3d.reading.test_curve_reading import ARCH

CURL = bent([(160, -0.033), (300, 0.0), (600, 0.001)], (500, 500), 1.0)


def _drawn(course: np.ndarray, width_px: float = 3.0, seed: int = 3, clutter: float = 1e-6) -> RandomImage:
    plain = FluoroscopySettings(
        narrowest_px=width_px, widest_px=width_px, weakest=0.7, no_wire=0, two_devices=0, catheter=0, along_edge=0,
        in_vessel=0, tip_change=0, beads=0, markers=0, clutter=clutter, contrast=0, noise=2, field=0, jpeg=0,
    )  # fmt: skip
    return RandomFluoroscopy(plain, seed).along(0, [course])


@pytest.mark.parametrize("side_px", [256, 320, 512, 768, 1024, 1536, 3072])
def test_one_image_of_any_size_is_read_alike(side_px: int) -> None:
    drawn = _drawn(ARCH)
    way = cv2.INTER_AREA if side_px < 1024 else cv2.INTER_CUBIC
    reading = read(cv2.resize(drawn.image, (side_px, side_px), interpolation=way))
    points = (reading.points_px + 0.5) * 1024 / side_px - 0.5
    assert within(points, np.concatenate(drawn.wires[0])) > 0.95
    said = f"the image of {side_px} x {side_px} px was read at 1024 x 1024 px"
    assert (said in reading.notes) == (side_px != 1024)


@pytest.mark.parametrize("width_px", [1.5, 6.0, 8.0, 10.0])
def test_wires_of_any_width_are_read_and_nothing_else(width_px: float) -> None:
    drawn = _drawn(ARCH, width_px)
    reading = read(drawn.image)
    assert within(reading.points_px, np.concatenate(drawn.wires[0])) > 0.95
    assert within(np.concatenate(drawn.wires[0]), reading.points_px) > 0.95
    assert not reading.others
    smaller = {f"the image of 1024 x 1024 px was read at {side} x {side} px" for side in (512, 384)}
    assert bool(smaller & set(reading.notes)) == (width_px > 5)


@pytest.mark.parametrize("width_px", [5.0, 8.0])
def test_a_wide_wire_in_a_small_image_is_read(width_px: float) -> None:
    drawn = _drawn(ARCH, width_px * 1024 / 400)
    reading = read(cv2.resize(drawn.image, (400, 400), interpolation=cv2.INTER_AREA))
    points = (reading.points_px + 0.5) * 1024 / 400 - 0.5
    assert within(points, np.concatenate(drawn.wires[0]), 10.0) > 0.95  # 4 px of the image


@pytest.mark.parametrize("side_px", [256, 300])
def test_a_straight_line_across_a_small_image_is_no_wire_without_a_word(side_px: int) -> None:
    drawn = _drawn(np.array([(1023, 420), (0, 300)], float), 8.0)
    reading = read(cv2.resize(drawn.image, (side_px, side_px), interpolation=cv2.INTER_AREA))
    assert not reading.found or any("straight as a rod" in note for note in reading.notes)


@pytest.mark.parametrize("line", [[(0, 300), (700, 420)], [(300, 300), (700, 500)]], ids=["straight", "inside"])
def test_a_rod_as_thick_as_a_wide_wire_is_none(line: list[tuple[float, float]]) -> None:
    assert not read(_drawn(np.array(line[::-1], float), 8.0).image).found


@pytest.mark.parametrize("width_px", [2.5, 6.0])
def test_a_curled_tip_is_followed_to_its_end(width_px: float) -> None:
    drawn = _drawn(CURL, width_px)
    reading = read(drawn.image)
    assert within(reading.points_px, np.concatenate(drawn.wires[0])) > 0.97
    assert np.hypot(*(reading.points_px[0] - CURL[0])) < 6.0
