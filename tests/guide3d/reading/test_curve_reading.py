"""Curves from drawn probability maps: order, gaps, crossings, loops, folded tips, false marks, no and several wires."""

from __future__ import annotations

import time

import numpy as np
import pytest

from guide3d.reading.curve_reading import Prior, read_curves
from tests.guide3d.reading.drawn_maps import DrawnMaps, bent, clutter, maps_of, order_error, within

ARCH = bent([(60, 0.03), (200, 0.002), (250, 0.006), (500, 0.001)], (400, 700), -2.0)
LOOP = bent([(100, 0.0), (220, 0.0285), (300, 0.0)], (200, 600), 0.3)
HOOK = bent([(45, 0.07), (300, 0.0), (300, 0.002)], (500, 500), 1.0)
NINE = bent([(110, -0.055), (300, 0.0), (300, 0.002)], (500, 500), 1.0)
TWO = bent([(200, 0.004), (1200, -0.0003)], (120, 120), -0.3)


def _holds(maps: DrawnMaps, share: float = 0.99, order_px: float = 3.0, tip_px: float = 4.0) -> None:
    found = read_curves(maps.wire, maps.tip)
    curve = found.candidates[0]
    assert within(curve.points_px, maps.points_px) >= share
    assert within(maps.points_px, curve.points_px) >= share
    assert order_error(curve.points_px, maps.points_px) < order_px
    assert np.hypot(*(curve.points_px[0] - maps.points_px[0])) < tip_px
    assert len(curve.points_px) == len(curve.confidence) == len(curve.sd_px)


@pytest.mark.parametrize("course", [ARCH, LOOP, HOOK, NINE], ids=["arch", "loop", "hook", "nine"])
def test_a_whole_wire_is_read_tip_first(course: np.ndarray) -> None:
    _holds(maps_of(course))


@pytest.mark.parametrize("course", [ARCH, LOOP], ids=["arch", "loop"])
@pytest.mark.parametrize("seed", range(3))
def test_false_marks_and_a_gap_do_no_harm(course: np.ndarray, seed: int) -> None:
    _holds(clutter(maps_of(course, gaps=((340, 420),)), seed), share=0.88)


def test_a_wide_gap_is_bridged_and_said() -> None:
    maps = maps_of(ARCH, gaps=((300, 460),))
    curve = read_curves(maps.wire, maps.tip).candidates[0]
    assert curve.length_px > 0.98 * len(maps.points_px)
    assert curve.confidence.min() < 0.1
    assert (curve.confidence < 0.5).mean() == pytest.approx(160 / len(maps.points_px), abs=0.05)


@pytest.mark.parametrize("size_px", [512, 1024])
def test_how_wide_a_gap_is_bridged_goes_by_its_share_of_the_image(size_px: int) -> None:
    scale = size_px / 1024
    for gap_px, joined in ((150, True), (185, False)):
        maps = maps_of(scale * ARCH, size_px, gaps=((scale * 300, scale * (300 + gap_px)),))
        curve = read_curves(maps.wire, maps.tip).candidates[0]
        assert (curve.length_px > 0.98 * len(maps.points_px)) == joined


def test_two_devices_are_not_joined_where_more_than_a_third_would_be_guessed() -> None:
    line = np.stack([np.linspace(465, 0, 466), np.full(466, 500.0)], axis=1)
    for gap_px, others in ((130, 0), (165, 1)):
        maps = maps_of(line, gaps=((150, 150 + gap_px),), tip=0.0)
        found = read_curves(maps.wire)
        assert len(found.others) == others
        assert (found.candidates[0].confidence < 0.5).mean() < 1 / 3


def test_weak_parts_belong_to_the_wire() -> None:
    _holds(maps_of(ARCH, weak=((250, 420, 0.35),)))


def test_without_a_tip_map_the_end_inside_is_the_tip() -> None:
    maps = maps_of(ARCH, tip=0.0)
    for tip in (None, maps.tip):
        curve = read_curves(maps.wire, tip).candidates[0]
        assert np.hypot(*(curve.points_px[0] - maps.points_px[0])) < 5.0


def test_a_tip_that_lies_back_over_the_wire_is_followed() -> None:
    shaft = np.stack([np.linspace(400, 1023, 624), np.full(624, 500.0)], axis=1)
    folded = np.concatenate([np.stack([np.linspace(426, 400, 27), np.full(27, 500.0)], axis=1), shaft[1:]])
    maps = maps_of(folded)
    curve = read_curves(maps.wire, maps.tip).candidates[0]
    assert np.hypot(*(curve.points_px[0] - folded[0])) < 4.0
    assert curve.points_px[:, 0].min() < 410
    assert curve.length_px == pytest.approx(649, abs=16)


def test_no_wire_is_said() -> None:
    empty = np.zeros((300, 300), np.float32)
    assert not read_curves(empty, empty).candidates
    marks = clutter(DrawnMaps(ARCH, empty, empty), seed=1, pieces=0)
    assert not read_curves(marks.wire, marks.tip).candidates


def test_a_second_wire_is_a_curve_of_its_own() -> None:
    first, second = maps_of(ARCH), maps_of(TWO)
    found = read_curves(np.maximum(first.wire, second.wire), np.maximum(first.tip, second.tip))
    assert len(found.others) == 1
    read = sorted([found.candidates[0], found.others[0]], key=lambda curve: within(curve.points_px, ARCH))
    assert within(read[0].points_px, second.points_px) > 0.97
    assert within(read[1].points_px, first.points_px) > 0.97
    assert not read_curves(first.wire, first.tip).others


def test_both_ends_are_candidates_where_nothing_tells_the_tip() -> None:
    maps = maps_of(np.stack([np.linspace(300, 700, 401), np.full(401, 500.0)], axis=1), tip=0.0)
    tips = [curve.points_px[0, 0] for curve in read_curves(maps.wire, None).candidates]
    assert min(tips) < 310
    assert max(tips) > 690


def test_a_prior_decides_between_two_tips() -> None:
    maps = maps_of(np.stack([np.linspace(300, 700, 401), np.full(401, 500.0)], axis=1), tip=0.0)
    for ordered in (maps.points_px, maps.points_px[::-1]):
        curve = read_curves(maps.wire, None, prior=Prior(ordered + 6.0)).candidates[0]
        assert np.hypot(*(curve.points_px[0] - ordered[0])) < 5.0


def test_a_wire_may_end_in_a_catheter_or_at_the_rim_of_the_field() -> None:
    maps = maps_of(np.stack([np.linspace(300, 700, 401), np.full(401, 500.0)], axis=1), tip=0.0)
    right = np.zeros(maps.wire.shape, bool)
    right[:, 700:] = True
    loose = read_curves(maps.wire, None).candidates[0].score
    for given in ({"catheter": right.astype(np.float32)}, {"outside": right}):
        curve = read_curves(maps.wire, None, **given).candidates[0]
        assert curve.points_px[0, 0] < 310
        assert curve.score > loose + 20


def test_maps_of_different_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match=r"expected maps of one shape, got \(64, 64\) of the wire and \(32, 32\)"):
        read_curves(np.zeros((64, 64), np.float32), np.zeros((32, 32), np.float32))


def test_a_cluttered_map_is_read_in_a_tenth_of_a_second() -> None:
    maps = clutter(maps_of(ARCH), seed=5, marks=60, pieces=12)
    spent = []
    for _ in range(3):
        started = time.process_time()
        read_curves(maps.wire, maps.tip)
        spent.append(time.process_time() - started)
    assert min(spent) < 0.25  # of a loaded core; 0.03 to 0.05 s of a quiet one
