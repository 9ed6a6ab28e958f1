"""Scripted samples: truth beside observations, starts, moves, and the frontier."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from enn.encoder import (
    Samples,
    scripted_samples,
)
from enn.exploration import Frontier, Moves, PairMoves, moves_of, points_behind_tip
from tests.enn.rod import Rod, SleevedRod


def test_samples_hold_observations_and_the_truth(samples: Samples) -> None:
    assert len(samples) == 1000
    assert set(samples.observations) == {"image", "mask", "joints"}
    assert samples.observations["image"].dtype == np.uint8
    reach = np.linalg.norm(samples.points_mm[:, 0], axis=1)
    assert np.allclose(reach, 10 + samples.feeder[:, 0], atol=1e-3)  # mm: the rod's tip
    assert np.allclose(samples.points_mm[:, 1], samples.points_mm[:, 0] - 4 * samples.direction, atol=1e-3)
    assert np.allclose(np.linalg.norm(samples.direction, axis=1), 1, atol=1e-5)
    assert len(np.unique(samples.episode)) > 20


def test_samples_are_the_same_for_a_seed_and_others_for_another(samples: Samples) -> None:
    again, other = scripted_samples(Rod, 300, seed=0), scripted_samples(Rod, 300, seed=1)
    assert np.array_equal(again.points_mm, samples.points_mm[:300])
    assert not np.array_equal(again.points_mm, other.points_mm)


def test_roll_outs_start_at_given_states() -> None:
    starts = np.array([[0.04, 0.6]])
    drawn = scripted_samples(Rod, 600, seed=0, starts=starts)
    first = np.flatnonzero(np.diff(drawn.episode, prepend=-1))
    there = np.isclose(drawn.feeder[first, 0], 40) & np.isclose(drawn.direction[first, 0], np.sin(0.6))
    assert 0.15 < there.mean() < 0.7


def test_samples_need_their_truth() -> None:
    with pytest.raises(ValueError, match="shape, feeder, force is missing: add it"):
        scripted_samples(lambda: Rod(("image",)), 10, seed=0)
    with pytest.raises(ValueError, match="count must be at least 1, got 0"):
        scripted_samples(Rod, 0, seed=0)


def test_samples_need_as_many_rows_in_every_array(samples: Samples) -> None:
    with pytest.raises(ValueError, match="expected 3 rows in every array, got direction 2"):
        dataclasses.replace(samples.take(np.arange(3)), direction=samples.direction[:2])


def test_points_behind_the_tip_follow_the_wire() -> None:
    shape = np.array([[0, 0, 3.0], [0, 0, 1], [4, 0, 1]])
    points = points_behind_tip(shape, np.array([0, 1, 4, 99]))
    assert np.allclose(points, [[0, 0, 3], [0, 0, 2], [2, 0, 1], [4, 0, 1]])


@pytest.mark.parametrize("size", [2, 21])
def test_moves_persist_and_stay_in_range(size: int) -> None:
    moves = Moves(size, np.random.default_rng(0))
    actions = np.array([moves.action() for _ in range(2000)])
    assert np.abs(actions).max() <= 1
    translation = actions[:, 0 if size == 2 else -1]
    assert np.corrcoef(translation[1:], translation[:-1])[0, 1] > 0.5
    assert translation.mean() > 0.1  # more in than out


def test_the_frontier_prefers_rare_places() -> None:
    frontier = Frontier(np.random.default_rng(0))
    assert frontier.draw() is None
    for _ in range(500):
        frontier.add(np.zeros(1), np.zeros(3))
    frontier.add(np.ones(1), np.array((0.05, 0, 0)))
    assert len(frontier) == 2
    assert np.mean([frontier.draw()[0] for _ in range(200)]) > 0.9  # type: ignore[index]


def test_two_devices_move_alone_apart_and_together() -> None:
    moves = moves_of(4, np.random.default_rng(0))
    assert isinstance(moves, PairMoves)
    moves.start()
    drawn = np.array([moves.action() for _ in range(2000)])
    assert drawn.dtype == np.float32
    assert np.abs(drawn).max() <= 1.0
    wire, catheter = (np.abs(drawn[:, part]).sum(axis=1) > 0 for part in (slice(2), slice(2, 4)))
    together = (drawn[:, 0] == drawn[:, 2]) & wire & catheter
    for kind in (wire & ~catheter, catheter & ~wire, together, wire & catheter & ~together):
        assert 0.05 < kind.mean() < 0.6
    assert isinstance(moves_of(2, np.random.default_rng(0)), Moves)
    assert isinstance(moves_of(21, np.random.default_rng(0)), Moves)


def test_samples_of_two_devices_tell_of_both_feeders() -> None:
    drawn = scripted_samples(SleevedRod, 300, seed=0, seen=("feeder",))
    assert drawn.feeder.shape == (300, 7)
    assert set(drawn.observations) == {"image", "mask", "joints", "feeder"}
    np.testing.assert_allclose(drawn.feeder[:, 6], drawn.feeder[:, 0] - drawn.feeder[:, 3], atol=1e-3)  # mm
    assert np.ptp(drawn.feeder[:, 3]) > 5
    assert "feeder" not in scripted_samples(SleevedRod, 20, seed=0).observations
