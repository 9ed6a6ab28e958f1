"""The page of a wire in space: one file with data and pictures inside, and no way out of its script."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from guide3d.reading.image_reading import read
from guide3d.reading.output.overlay import confidence_colour, draw_reading, space_page
from guide3d.reading.pair_reading import PairReading, read_pair
from guide3d.reconstruction.synthetic_scene import scenes
from tests.guide3d.reading.drawn_maps import DarkLineReader, maps_of, picture

SCENE = next(iter(scenes(1, seed=77)))


@pytest.fixture(scope="module")
def reading() -> PairReading:
    images = [picture(maps_of(points)) for points in SCENE.points]
    return read_pair(*images, SCENE.cameras, reader=DarkLineReader())


def test_data_and_pictures_stand_in_the_page(reading: PairReading) -> None:
    page = space_page([None, reading], [np.zeros((20, 30, 3), np.uint8)], 'a "title"</script><b>')
    assert page.count("</script>") == 1
    found = re.search(r"^const data = (.*);$", page, re.MULTILINE)
    assert found is not None
    data = json.loads(found[1])
    assert data["title"] == 'a "title"</script><b>'
    assert data["frames"][0] is None
    points = np.array(data["frames"][1]["points"])
    assert np.abs(points[[0, -1]] - reading.curve_mm[[0, -1]]).max() < 1e-3
    assert len(points) == len(data["frames"][1]["sd"])
    assert data["pictures"][0].startswith("data:image/jpeg;base64,")
    assert not re.search(r"https?://|src=|href=", page)


def test_an_overlay_shows_confidence_by_colour() -> None:
    maps = maps_of(SCENE.points[0], gaps=((150, 260),))
    image = picture(maps)
    overlay = draw_reading(image, read(image, DarkLineReader()), truth_px=SCENE.points[0][::50])
    assert overlay.shape == (1024, 1024, 3)
    red, green = (overlay == confidence_colour(share) for share in (0.0, 1.0))
    assert red.all(axis=2).any() or (overlay[..., 0].astype(int) - overlay[..., 1] > 60).any()
    assert green.all(axis=2).any() or (overlay[..., 1].astype(int) - overlay[..., 0] > 60).any()


def test_colours_run_from_red_to_green() -> None:
    colours = [confidence_colour(share) for share in (-1.0, 0.0, 0.5, 1.0, 2.0)]
    assert colours[0] == colours[1]
    assert colours[3] == colours[4]
    assert colours[1][0] > colours[1][1]
    assert colours[3][1] > colours[3][0]
