"""Advised episodes: who steers, what is kept of them, and rounds of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from enn.imitation.advised_episodes import FIRST_NOISE, NOISE, TEACHER_SHARE, advised_rounds
from enn.imitation.images.egocentric import VIEW_SIZE
from enn.imitation.sequence_cloning import AdvisedEpisode
from tests.enn.imitation.straight_wire import CLONING, advised, policy_on, untrained


def test_teacher_and_policy_steer_and_the_teacher_advises() -> None:
    perception = untrained()
    policy = policy_on(perception)
    by_teacher, by_policy = advised(policy, perception, 1.0, 1), advised(policy, perception, 0.0, 2, 8)
    assert all(one.success for one in by_teacher)
    assert not any(one.success for one in by_policy)
    for one in (*by_teacher, *by_policy):
        np.testing.assert_allclose(one.actions[:, 0], np.clip(5 * one.hints[:, 0], -1, 1))  # advice, without noise
        assert one.features.shape == (len(one.hints), VIEW_SIZE)
        assert one.target == "dot"


def test_episodes_repeat_themselves() -> None:
    perception = untrained()
    policy = policy_on(perception)
    pairs = zip(advised(policy, perception, 0.5, 5, 6), advised(policy, perception, 0.5, 5, 6), strict=True)
    for one, other in pairs:
        np.testing.assert_array_equal(one.features, other.features)
        np.testing.assert_array_equal(one.actions, other.actions)


def test_rounds_aggregate_and_go_on_where_they_stopped() -> None:
    perception = untrained()
    asked: list[tuple[int, float, float]] = []

    def rounds(numbers: range, episodes: list[AdvisedEpisode]) -> list[int]:
        policy = policy_on(perception)

        def play(number: int, teacher_share: float, noise: float) -> list[AdvisedEpisode]:
            asked.append((number, teacher_share, noise))
            return advised(policy, perception, 1.0, number, 2)

        passes: dict[int, int] = {}
        found = advised_rounds(
            policy, episodes, play, replace(CLONING, epochs=2), rounds=numbers, seed_of=lambda number: number,
            progress=lambda number, epoch, loss: passes.update({number: epoch}),
        )  # fmt: skip
        assert [len(one.new) for one in found] == [2] * len(numbers)
        return list(passes.values())

    episodes: list[AdvisedEpisode] = []
    assert rounds(range(3), episodes) == [2, 2, 4]  # the last round has twice as many epochs
    assert len(episodes) == 6
    assert asked == [(0, 1.0, FIRST_NOISE), (1, TEACHER_SHARE, NOISE), (2, TEACHER_SHARE, NOISE)]
    asked.clear()
    rounds(range(1), episodes[:2])  # with something learnt before, the policy steers from the start
    rounds(range(2, 3), episodes[:4])
    assert asked == [(0, TEACHER_SHARE, NOISE), (2, TEACHER_SHARE, NOISE)]
