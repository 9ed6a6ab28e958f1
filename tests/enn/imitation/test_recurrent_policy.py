"""Recurrent policies, the cloning of sequences, and rounds of advised episodes on disk."""

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

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
from enn.imitation.recurrent_policy import RecurrentController, RecurrentPolicy, RecurrentPolicySettings
from enn.imitation.sequence_cloning import AdvisedEpisode, SequenceCloningSettings, clone_sequences

SETTINGS = RecurrentPolicySettings(
    features=10, encoder_blocks=((1, 3), (6, 3)), block_units=2, hidden=8, action_repeat=3
)


def scaled(settings: RecurrentPolicySettings = SETTINGS, seed: int = 1) -> RecurrentPolicy:
    """A policy whose features count as they are."""
    policy = RecurrentPolicy(settings, seed)
    policy.network.scale.fill_(1.0)
    return policy


def features(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, (2, SETTINGS.features)).astype(np.float32)


def test_the_state_remembers_and_the_seed_decides() -> None:
    policy = scaled()
    first, state = policy.act(features())
    second, _ = policy.act(features(), state)
    assert first.shape == (2, 2)
    assert (np.abs(first) <= 1).all()
    assert (first != second).any()  # the features are the same, what came before is not
    np.testing.assert_array_equal(first, scaled().act(features())[0])
    assert (first != scaled(seed=2).act(features())[0]).any()


class Counting:
    """A perception whose features are the number of decisions so far, and the last action."""

    def __call__(self, views: Sequence[list[int]], observations: Sequence[Any], actions: Sequence[Any]) -> np.ndarray:
        rows = np.zeros((len(views), SETTINGS.features), np.float32)
        for row, view, action in zip(rows, views, actions, strict=True):
            view.append(len(view))
            row[0], row[-2:] = len(view), action
        return rows


def test_controller_asks_once_a_decision_and_forgets_between_episodes() -> None:
    views: list[list[int]] = []

    def begin(observation: Any) -> list[int]:
        views.append([])
        return views[-1]

    steer = RecurrentController(scaled(), Counting(), begin)
    actions = np.array([steer({}) for _ in range(7)])
    assert len(views[0]) == 3
    np.testing.assert_array_equal(actions[0], actions[2])
    assert (actions[2] != actions[3]).any()
    steer.reset()
    np.testing.assert_array_equal([steer({}) for _ in range(7)], actions)
    assert len(views) == 2


SEQUENCE_CLONING_SETTINGS = RecurrentPolicySettings(features=12, encoder_blocks=((4, 6),), hidden=32)
CLONING = SequenceCloningSettings(epochs=40, batch_size=8)


def drawn_episodes(count: int = 12, hints: int = 0) -> list[AdvisedEpisode]:
    """Episodes in which the first feature gives the translation, and the one before it the rotation."""
    generator = np.random.default_rng(3)
    found = []
    for _ in range(count):
        length = int(generator.integers(6, 15))
        features = generator.uniform(-1, 1, (length, SEQUENCE_CLONING_SETTINGS.features)).astype(np.float32)
        before = np.concatenate(([0.0], features[:-1, 0]))
        actions = np.stack((0.8 * features[:, 0], 0.8 * before), axis=1).astype(np.float32)
        found.append(AdvisedEpisode(features, actions, np.full((length, hints), 0.5, np.float32), True))
    return found


def test_cloning_learns_what_was_done_and_what_was_before() -> None:
    episodes = drawn_episodes(40)
    policy = RecurrentPolicy(SEQUENCE_CLONING_SETTINGS)
    losses = clone_sequences(policy, episodes, CLONING)
    assert losses[-1] < 0.25 * losses[0]
    brief = replace(CLONING, epochs=2, updates=17)
    few, again = (clone_sequences(RecurrentPolicy(SEQUENCE_CLONING_SETTINGS), episodes, brief) for _ in range(2))
    assert few == again
    assert len(few) == 4  # of five batches each
    assert not policy.network.training


def test_hints_and_noise_count_where_they_are_asked_for() -> None:
    def first_loss(hints: int, **changed: float) -> float:
        policy = RecurrentPolicy(replace(SEQUENCE_CLONING_SETTINGS, hints=hints))
        cloning = replace(CLONING, epochs=1, **changed)  # type: ignore[arg-type]
        return clone_sequences(policy, drawn_episodes(8, hints), cloning)[0]

    state = torch.get_rng_state()
    assert first_loss(2, hint_weight=10.0) > first_loss(2, hint_weight=0.1)
    assert first_loss(0, hint_weight=10.0) == first_loss(0, hint_weight=0.1)
    assert first_loss(0, noise=0.5) != first_loss(0)
    assert torch.equal(torch.get_rng_state(), state)


def test_bad_episodes_are_refused() -> None:
    policy, good = RecurrentPolicy(replace(SEQUENCE_CLONING_SETTINGS, hints=3)), drawn_episodes(1, 3)[0]
    with pytest.raises(ValueError, match="at least one episode"):
        clone_sequences(policy, [], CLONING)
    with pytest.raises(ValueError, match="takes 12 features, 2 actions and 3 hints, got 11, 2 and 3"):
        clone_sequences(policy, [replace(good, features=good.features[:, :-1])], CLONING)
    with pytest.raises(ValueError, match="hints must be finite"):
        replace(good, hints=np.full_like(good.hints, np.nan))
    with pytest.raises(ValueError, match="as many features as actions"):
        replace(good, actions=good.actions[:-1])


ROUND_SETTINGS = RecurrentPolicySettings(features=4, hidden=8)


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
    policy = RecurrentPolicy(ROUND_SETTINGS) if last is None else RecurrentPolicy.load(last)
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
