"""Random fluoroscopy: the same pixels from the same seed, masks that match the wire, and every kind of clutter."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

from guide3d.random_fluoroscopy.anatomy import ANATOMY
from guide3d.random_fluoroscopy.phantom_clutter import PHANTOM_CLUTTER
from guide3d.random_fluoroscopy.random_fluoroscopy import RandomFluoroscopy, RandomImage
from guide3d.random_fluoroscopy.settings import FluoroscopySettings
from guide3d.random_fluoroscopy.small_marks import SMALL_MARKS

PLAIN = FluoroscopySettings(
    no_wire=0.0, two_devices=0.0, catheter=0.0, along_edge=0.0, in_vessel=0.0, tip_change=0.0, beads=0.0, markers=0.0,
    clutter=1e-6, anatomy=0.0, contrast=0.0, field=0.0, noise=0.31, jpeg=0.0, narrowest_px=3.0, weakest=0.65,
)  # fmt: skip


@functools.cache
def tiles(count: int = 120) -> list[RandomImage]:
    fluoroscopy = RandomFluoroscopy(seed=3)
    return [fluoroscopy.tile(index, 128) for index in range(count)]


def test_seed_and_index_give_the_same_pixels() -> None:
    first, second = RandomFluoroscopy(seed=7).tile(5, 96), RandomFluoroscopy(seed=7).tile(5, 96)
    for name in ("image", "wire", "catheter", "tip", "tips"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert first.kinds == second.kinds
    assert not np.array_equal(first.image, RandomFluoroscopy(seed=8).tile(5, 96).image)
    assert not np.array_equal(first.image, RandomFluoroscopy(seed=7).tile(6, 96).image)


def test_shapes_and_types() -> None:
    for drawn in tiles()[:10]:
        for values, kind in ((drawn.image, np.uint8), (drawn.wire, np.uint8), (drawn.catheter, np.uint8)):
            assert values.shape == (128, 128)
            assert values.dtype == kind
        assert drawn.tip.dtype == np.float32
        assert 0 <= drawn.tip.min() <= drawn.tip.max() <= 1


@pytest.mark.parametrize("kind", [*PHANTOM_CLUTTER, *SMALL_MARKS, *ANATOMY])
def test_clutter_occurs(kind: str) -> None:
    assert any(kind in drawn.kinds for drawn in tiles())


@pytest.mark.parametrize(
    "kind",
    [
        "no wire", "two wires", "loop", "hairpin", "bent tip", "angled tip", "folded tip", "curled tip", "changed tip",
        "markers", "beads on the wire", "tip on a dark vessel", "wire along an edge", "wire in a vessel",
        "contrast vessels", "catheter over the wire", "catheter beside the wire", "catheter alone", "round field",
        "square field", "octagon field", "collimated field", "open field",
    ],
)  # fmt: skip
def test_situation_occurs(kind: str) -> None:
    share = np.mean([kind in drawn.kinds for drawn in tiles()])
    assert 0 < share < 0.9


def test_a_fair_share_of_tiles_is_empty_or_has_a_tip() -> None:
    assert 0.1 < np.mean([not drawn.wire.any() for drawn in tiles()]) < 0.55
    assert 0.2 < np.mean([len(drawn.tips) > 0 for drawn in tiles()]) < 0.7


def test_the_mask_lies_on_the_dark_wire() -> None:
    fluoroscopy = RandomFluoroscopy(PLAIN, seed=1)
    for index in range(6):
        drawn = fluoroscopy.tile(index, 192)
        on = drawn.wire > 200
        if on.sum() < 200:
            continue
        away = drawn.wire == 0
        (line,) = (piece for pieces in drawn.wires for piece in pieces[:1])
        x, y = np.clip(np.rint(line).astype(int), 0, 191).T
        assert np.median(drawn.image[y, x]) < 0.9 * np.median(drawn.image[away])
        assert (drawn.wire[y, x] > 127).mean() > 0.98


def test_a_tip_is_the_first_point_of_its_wire() -> None:
    for drawn in tiles():
        for tip in drawn.tips[((drawn.tips > 6) & (drawn.tips < 121)).all(axis=1)]:
            assert any(np.allclose(pieces[0][0], tip) for pieces in drawn.wires if pieces)
            x, y = np.clip(np.rint(tip).astype(int), 0, 127)
            assert drawn.tip[y, x] > 0.7
            assert drawn.wire[y, x] > 100


def test_a_tile_shows_a_part_of_the_image() -> None:
    fluoroscopy = RandomFluoroscopy(replace(PLAIN, image_px=512), seed=2)
    whole, tile = fluoroscopy.image(4), fluoroscopy.tile(4, 128)
    part = whole.wire[tile.top : tile.top + 128, tile.left : tile.left + 128]
    assert tile.wire.any()
    np.testing.assert_allclose(part[2:-2, 2:-2].astype(int), tile.wire[2:-2, 2:-2].astype(int), atol=2)


def test_without_wires_there_is_none() -> None:
    fluoroscopy = RandomFluoroscopy(replace(PLAIN, no_wire=1.0), seed=0)
    for index in range(3):
        drawn = fluoroscopy.tile(index, 64)
        assert not drawn.wire.any()
        assert not len(drawn.tips)
        assert not drawn.wires


@pytest.mark.parametrize("columns", [2, 3])
def test_given_courses_are_followed(columns: int) -> None:
    along = np.linspace(0, 1, 80)[:, None]
    curve = np.hstack((150 * along, 40 * np.sin(4 * along), 20 * along))[:, :columns]
    fluoroscopy = RandomFluoroscopy(replace(PLAIN, given_course=1.0), seed=0, courses=[curve])
    kinds = set().union(*(fluoroscopy.tile(index, 64).kinds for index in range(4)))
    assert "given course" in kinds


def test_given_backgrounds_are_seen() -> None:
    dark = np.zeros((60, 80))
    dark[::2] = 1.0
    settings = replace(PLAIN, background=1.0)
    with_it = RandomFluoroscopy(settings, seed=0, backgrounds=[dark]).tile(0, 128)
    assert "given background" in with_it.kinds
    assert with_it.image.std() > 2 * RandomFluoroscopy(settings, seed=0).tile(0, 128).image.std()


def test_bad_arguments_are_refused() -> None:
    with pytest.raises(ValueError, match="size_px: expected 32 to 1024 px"):
        RandomFluoroscopy().tile(0, 2048)
    with pytest.raises(ValueError, match="a course must be"):
        RandomFluoroscopy(courses=[np.zeros((3, 4))])
    with pytest.raises(ValueError, match="a background must be"):
        RandomFluoroscopy(backgrounds=[np.full((3, 4), np.nan)])
    with pytest.raises(ValueError, match="narrowest_px must not exceed"):
        FluoroscopySettings(narrowest_px=5.0)
    with pytest.raises(ValueError, match="strongest <= weakest"):
        FluoroscopySettings(strongest=0.95)
    with pytest.raises(ValueError, match="near_tip"):
        FluoroscopySettings(near_tip=0.8)


def test_clutter_alone_has_no_device_and_means_what_passes() -> None:
    fluoroscopy = RandomFluoroscopy(replace(PLAIN, clutter=1.0, anatomy=0.5), seed=2)
    whole, small = fluoroscopy.clutter(4), fluoroscopy.clutter(4, 128)
    assert (whole.shape, small.shape, small.dtype) == ((1024, 1024), (128, 128), np.float32)
    np.testing.assert_array_equal(
        small, RandomFluoroscopy(replace(fluoroscopy.settings, no_wire=1.0), 2).clutter(4, 128)
    )
    passed = np.exp(-whole).reshape(128, 8, 128, 8).mean((1, 3))
    np.testing.assert_allclose(np.exp(-small), passed, atol=1e-5)
    assert whole.std() > 0.02
    assert not np.array_equal(small, fluoroscopy.clutter(5, 128))
    assert RandomFluoroscopy(PLAIN, seed=2).clutter(4).std() < 0.5 * whole.std()


def test_clutter_of_an_impossible_size_is_refused() -> None:
    with pytest.raises(ValueError, match="size_px: expected 32 to 1024 px"):
        RandomFluoroscopy().clutter(0, 2000)
