"""Rounds of advised episodes on disk: they come back, and a stopped training goes on after its last whole round."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from enn.imitation.advised_rounds import (
    FIRST_NOISE,
    NOISE,
    TEACHER_SHARE,
    finished_rounds,
    forget_rounds,
    last_policy,
    read_episodes,
    teach,
    write_episodes,
)
from enn.imitation.recurrent_policy import RecurrentPolicy, RecurrentPolicySettings
from enn.imitation.sequence_cloning import AdvisedEpisode, SequenceCloningSettings

SETTINGS = RecurrentPolicySettings(features=4, hidden=8)


def episodes_of(number: int) -> list[AdvisedEpisode]:
    generator = np.random.default_rng(number)
    shapes = ((5, 4), (5, 2), (5, 0))
    arrays = (generator.uniform(-1, 1, shape).astype(np.float32) for shape in shapes)
    return [AdvisedEpisode(*arrays, success=bool(number % 2), target="bca")]


def train(
    folder: Path, rounds: int, before: int = 0
) -> tuple[RecurrentPolicy, list[tuple[int, float, float]], int, list[float]]:
    """The policy, the rounds that were played, the episodes that it has learnt from, and the shares that were told."""
    last = last_policy(folder)
    policy = RecurrentPolicy(SETTINGS) if last is None else RecurrentPolicy.load(last)
    played: list[tuple[int, float, float]] = []
    episodes = [episode for number in range(before) for episode in episodes_of(number)]
    shares: list[float] = []

    def play(number: int, teacher_share: float, noise: float) -> list[AdvisedEpisode]:
        played.append((number, teacher_share, noise))
        if number >= rounds:
            raise KeyboardInterrupt
        return episodes_of(number)

    done = teach(
        folder, policy, episodes, play, SequenceCloningSettings(epochs=1), rounds=3, seed=1, began=time.monotonic(),
        report=lambda share, text: shares.append(share),
    )  # fmt: skip
    assert [one.new[0].success for one in done] == [False, True, False]
    return policy, played, len(episodes), shares


def test_a_stopped_training_goes_on_after_its_last_round(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        train(tmp_path / "stopped", 2)
    assert len(finished_rounds(tmp_path / "stopped")) == 2
    policy, played, count, _ = train(tmp_path / "stopped", 3)
    assert (played, count) == ([(2, TEACHER_SHARE, NOISE)], 3)
    whole, played, _, shares = train(tmp_path / "whole", 3)
    assert played == [(0, 1.0, FIRST_NOISE), (1, TEACHER_SHARE, NOISE), (2, TEACHER_SHARE, NOISE)]
    assert len(shares) == 4  # the last round has twice as many epochs
    # with something learnt before, the policy steers from the start
    assert train(tmp_path / "further", 3, before=1)[1][0] == (0, TEACHER_SHARE, NOISE)
    features = np.ones((1, 4), np.float32)
    np.testing.assert_array_equal(policy.act(features)[0], whole.act(features)[0])
    forget_rounds(tmp_path / "stopped")
    assert last_policy(tmp_path / "stopped") is None


def test_episodes_come_back_with_their_targets(tmp_path: Path) -> None:
    episodes = [
        AdvisedEpisode(np.full((n, 4), n, np.float32), np.zeros((n, 2)), np.zeros((n, 0)), n > 1, name)
        for n, name in ((1, "bca"), (3, "lcca"))
    ]
    write_episodes(tmp_path / "round0.npz", episodes)
    back = read_episodes(tmp_path / "round0.npz")
    assert [(len(one.features), one.success, one.target) for one in back] == [(1, False, "bca"), (3, True, "lcca")]
    np.testing.assert_array_equal(back[1].features, episodes[1].features)
