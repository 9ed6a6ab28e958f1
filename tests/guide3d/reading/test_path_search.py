"""Beam search over pieces, on graphs small enough to know the answer."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from guide3d.reading.links import Link
from guide3d.reading.path_search import SearchSettings, search


def _links(count: int, costs: dict[tuple[int, int], float], empty_px: float = 0.0) -> list[list[Link]]:
    links: list[list[Link]] = [[] for _ in range(2 * count)]
    for (leave, enter), cost in costs.items():
        links[leave].append(Link(enter, cost, empty_px))
        links[enter].append(Link(leave, cost, empty_px))
    return links


def test_a_chain_is_walked_from_the_cheap_start() -> None:
    links = _links(3, {(1, 2): 5.0, (3, 4): 5.0})
    start, stop = np.full(6, 50.0), np.full(6, 50.0)
    start[5], stop[0] = 0.0, 0.0
    best = search(np.full(3, 40.0), np.full(3, 40.0), links, start, stop, np.zeros(3, bool), SearchSettings())[0]
    assert best.entries == (5, 3, 1)
    assert best.score == 110.0


@pytest.mark.parametrize(("empty_px", "pieces"), [(38.0, 2), (42.0, 1)])
def test_pieces_are_joined_unless_gaps_are_more_than_a_third_of_the_path(empty_px: float, pieces: int) -> None:
    length = np.array([35.0, 45.0])
    links = _links(2, {(1, 2): 5.0}, empty_px)
    found = search(length, length, links, np.zeros(4), np.zeros(4), np.zeros(2, bool), SearchSettings())
    assert len(found[0].pieces) == pieces


def test_the_best_path_is_that_of_all_permutations() -> None:
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
        found = search(worth, worth, links, start, stop, np.zeros(count, bool), SearchSettings(beam=500))
        assert abs(found[0].score - best) < 1e-9


def test_a_shared_piece_is_walked_twice_where_a_tip_lies_back() -> None:
    # piece 0 is the fold with the tip at its joined end 0, piece 1 the shaft that begins there
    links = _links(2, {(0, 2): 0.0})
    start, stop = np.array([0.0, 60.0, 60.0, 60.0]), np.array([60.0, 60.0, 60.0, 0.0])
    shared = np.array([True, False])
    best = search(np.array([25.0, 300.0]), np.array([25.0, 300.0]), links, start, stop, shared, SearchSettings())[0]
    assert best.entries == (0, 1, 2)
