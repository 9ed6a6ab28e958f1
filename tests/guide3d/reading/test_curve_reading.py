"""Curves from maps of a wire: pieces, links, paths, ends, confidence."""

import itertools

import numpy as np
import pytest

from guide3d.geometry.polyline import distances_to
from guide3d.opencv import cv2
from guide3d.reading.curve_reading import read_curves
from guide3d.reading.links import Link, bending_energy
from guide3d.reading.path_drawing import centre_line, to_border
from guide3d.reading.path_search import search
from guide3d.reading.ridges import find_pieces
from tests.guide3d.reading.drawn_maps import DrawnMaps, bent, clutter, maps_of, order_error, soft_line, within

ARCH = bent([(60, 0.03), (200, 0.002), (250, 0.006), (500, 0.001)], (400, 700), -2.0)
LOOP = bent([(100, 0.0), (220, 0.0285), (300, 0.0)], (200, 600), 0.3)
HOOK = bent([(45, 0.07), (300, 0.0), (300, 0.002)], (500, 500), 1.0)
NINE = bent([(110, -0.055), (300, 0.0), (300, 0.002)], (500, 500), 1.0)
TWO = bent([(200, 0.004), (1200, -0.0003)], (120, 120), -0.3)


def _holds(maps: DrawnMaps, share: float = 0.99) -> None:
    found = read_curves(maps.wire, maps.tip)
    curve = found.candidates[0]
    assert within(curve.points_px, maps.points_px) >= share
    assert within(maps.points_px, curve.points_px) >= share
    assert order_error(curve.points_px, maps.points_px) < 3.0
    assert np.hypot(*(curve.points_px[0] - maps.points_px[0])) < 4.0
    assert len(curve.points_px) == len(curve.confidence) == len(curve.sd_px)


@pytest.mark.parametrize("course", [ARCH, LOOP, HOOK, NINE], ids=["arch", "loop", "hook", "nine"])
def test_a_whole_wire_is_read_tip_first(course: np.ndarray) -> None:
    _holds(maps_of(course))


@pytest.mark.parametrize(("course", "seed"), [(ARCH, 0), (LOOP, 1)], ids=["arch", "loop"])
def test_false_marks_and_a_gap_do_no_harm(course: np.ndarray, seed: int) -> None:
    _holds(clutter(maps_of(course, gaps=((340, 420),)), seed), share=0.88)


def test_a_wide_gap_is_bridged_and_said() -> None:
    maps = maps_of(ARCH, gaps=((300, 460),))
    curve = read_curves(maps.wire, maps.tip).candidates[0]
    assert curve.length_px > 0.98 * len(maps.points_px)
    assert curve.confidence.min() < 0.1
    assert (curve.confidence < 0.5).mean() == pytest.approx(160 / len(maps.points_px), abs=0.05)


def test_two_devices_are_not_joined_where_more_than_a_third_would_be_guessed() -> None:
    line = np.stack([np.linspace(465, 0, 466), np.full(466, 500.0)], axis=1)
    for gap_px, others in ((130, 0), (165, 1)):
        maps = maps_of(line, gaps=((150, 150 + gap_px),), tip=0.0)
        found = read_curves(maps.wire)
        assert len(found.others) == others
        assert (found.candidates[0].confidence < 0.5).mean() < 1 / 3


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


def test_a_second_wire_is_a_curve_of_its_own() -> None:
    first, second = maps_of(ARCH), maps_of(TWO)
    found = read_curves(np.maximum(first.wire, second.wire), np.maximum(first.tip, second.tip))
    assert len(found.others) == 1
    read = sorted([found.candidates[0], found.others[0]], key=lambda curve: within(curve.points_px, ARCH))
    assert within(read[0].points_px, second.points_px) > 0.97
    assert within(read[1].points_px, first.points_px) > 0.97
    assert not read_curves(first.wire, first.tip).others


def test_a_wire_may_end_in_a_catheter_or_at_the_rim_of_the_field() -> None:
    maps = maps_of(np.stack([np.linspace(300, 700, 401), np.full(401, 500.0)], axis=1), tip=0.0)
    right = np.zeros(maps.wire.shape, bool)
    right[:, 700:] = True
    loose = read_curves(maps.wire, None).candidates[0].score
    for given in ({"catheter": right.astype(np.float32)}, {"outside": right}):
        curve = read_curves(maps.wire, None, **given).candidates[0]
        assert curve.points_px[0, 0] < 310
        assert curve.score > loose + 20


NO_CUTS = np.empty((0, 2))


def test_a_line_is_one_piece_with_its_directions() -> None:
    line = np.stack([np.linspace(40, 200, 161), np.linspace(60, 60, 161)], axis=1)
    pieces = find_pieces(soft_line((256, 256), line), NO_CUTS)
    assert len(pieces) == 1
    assert abs(pieces.lengths[0] - 161) < 8
    order = np.argsort(pieces.ends[:, 0])
    assert np.abs(pieces.ends[order] - [[40, 60], [200, 60]]).max() < 4
    assert np.abs(pieces.outward[order] - [[-1, 0], [1, 0]]).max() < 0.15
    assert not pieces.joined.any()


def test_a_crossing_gives_four_pieces_with_joined_ends() -> None:
    shape = (256, 256)
    across = np.maximum(soft_line(shape, [[20, 128], [230, 128]]), soft_line(shape, [[128, 20], [128, 230]]))
    pieces = find_pieces(across, NO_CUTS)
    assert len(pieces) == 4
    assert pieces.joined.reshape(-1, 2).sum(axis=1).tolist() == [1, 1, 1, 1]


def test_a_tip_on_a_wire_cuts_it() -> None:
    line = soft_line((256, 256), [[20, 128], [230, 128]])
    pieces = find_pieces(line, np.array([[90.0, 129.0]]))
    assert len(pieces) == 2
    assert np.abs(pieces.ends - [90, 128]).sum(axis=1).min() < 3


@pytest.mark.parametrize("turn", [0.1, 1.0])
def test_energy_of_an_arc_is_that_of_the_circle(turn: float) -> None:
    radius = 200.0
    gap = radius * np.array([[np.sin(turn), 1 - np.cos(turn)]])
    energy = bending_energy(np.array([[1.0, 0.0]]), np.array([[np.cos(turn), np.sin(turn)]]), gap, 1e-3)
    assert energy[0] == pytest.approx(turn / radius, rel=0.1)  # curvature^2 times length


def _links(count: int, costs: dict[tuple[int, int], float], empty_px: float = 0.0) -> list[list[Link]]:
    links: list[list[Link]] = [[] for _ in range(2 * count)]
    for (leave, enter), cost in costs.items():
        links[leave].append(Link(enter, cost, empty_px))
        links[enter].append(Link(leave, cost, empty_px))
    return links


@pytest.mark.parametrize(("empty_px", "pieces"), [(38.0, 2), (42.0, 1)])
def test_pieces_are_joined_unless_gaps_are_more_than_a_third_of_the_path(empty_px: float, pieces: int) -> None:
    length = np.array([35.0, 45.0])
    links = _links(2, {(1, 2): 5.0}, empty_px)
    found = search(length, length, links, np.zeros(4), np.zeros(4), np.zeros(2, bool))
    assert len(found[0].pieces) == pieces


def test_the_best_path_is_that_of_all_permutations(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("guide3d.reading.path_search._BEAM", 500)
    rng = np.random.default_rng(0)
    for _ in range(10):
        count = 4
        worth = rng.uniform(10, 60, count)
        start, stop = rng.uniform(0, 60, 2 * count), rng.uniform(0, 60, 2 * count)
        pairs = [(i, j) for i, j in itertools.combinations(range(2 * count), 2) if i // 2 != j // 2]
        costs = {pair: float(rng.uniform(0, 60)) for pair in pairs}
        links = _links(count, costs)
        best = -np.inf
        for size in range(1, count + 1):
            for order in itertools.permutations(range(count), size):
                for sides in itertools.product((0, 1), repeat=size):
                    ends = [2 * piece + side for piece, side in zip(order, sides, strict=True)]
                    gaps = [costs[min(a ^ 1, b), max(a ^ 1, b)] for a, b in itertools.pairwise(ends)]
                    best = max(best, worth[list(order)].sum() - sum(gaps) - start[ends[0]] - stop[ends[-1] ^ 1])
        found = search(worth, worth, links, start, stop, np.zeros(count, bool))
        assert abs(found[0].score - best) < 1e-9


SHAPE = (400, 400)


def test_a_wire_goes_straight_on_where_nothing_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("guide3d.reading.path_drawing._LONGEST", 0.4)
    seen = np.stack([np.arange(99.0, 301.0), np.full(202, 200.0)], axis=1)
    exposed = np.pad(np.ones((50, 50), np.uint8), 1)
    away = np.asarray((cv2.distanceTransform(exposed, cv2.DIST_L2, 3)[1:-1, 1:-1] - 0.5) * 8, np.float32)
    line = to_border(seen, np.zeros(SHAPE, np.float32), away, 8)
    assert 390 < line[-1, 0] <= 400
    assert abs(line[-1, 1] - 200) < 1.0
    assert np.array_equal(line[: len(seen)], seen)


COURSE = bent([(80, 0.02), (150, -0.004), (150, 0.0)], (150, 120), 0.0)


def test_a_shifted_path_goes_back_to_the_ridge() -> None:
    wire = maps_of(COURSE, 512).wire
    shifted = COURSE + np.random.default_rng(0).normal(0, 0.6, COURSE.shape) + [0.8, -0.8]
    line, confidence, deviation = centre_line(shifted, wire)
    off = distances_to(COURSE, line[3:-3])
    assert off.mean() < 0.25
    assert off.max() < 1.0
    assert confidence.min() > 0.7
    assert np.allclose(deviation, 0.7)


def test_a_gap_has_no_confidence_and_a_growing_deviation() -> None:
    maps = maps_of(COURSE, 512, gaps=((200, 300),))
    line, confidence, deviation = centre_line(COURSE[::8], maps.wire)
    middle = int(np.hypot(*(line - COURSE[250]).T).argmin())
    assert confidence[middle] < 0.05
    assert deviation[middle] > 4.0
    assert distances_to(COURSE, line).max() < 3.0
