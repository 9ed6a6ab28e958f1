"""Cloning of episodes: what was done is learnt, also what depends on before, and bad episodes are refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from enn.imitation.recurrent_policy import RecurrentPolicy, RecurrentPolicySettings
from enn.imitation.sequence_cloning import AdvisedEpisode, SequenceCloningSettings, clone_sequences

SETTINGS = RecurrentPolicySettings(features=12, encoder_blocks=((4, 6),), hidden=32)
CLONING = SequenceCloningSettings(epochs=40, batch_size=8)


def drawn_episodes(count: int = 12, hints: int = 0) -> list[AdvisedEpisode]:
    """Episodes in which the first feature gives the translation, and the one before it the rotation."""
    generator = np.random.default_rng(3)
    found = []
    for _ in range(count):
        length = int(generator.integers(6, 15))
        features = generator.uniform(-1, 1, (length, SETTINGS.features)).astype(np.float32)
        before = np.concatenate(([0.0], features[:-1, 0]))
        actions = np.stack((0.8 * features[:, 0], 0.8 * before), axis=1).astype(np.float32)
        found.append(AdvisedEpisode(features, actions, np.full((length, hints), 0.5, np.float32), True))
    return found


def test_cloning_learns_what_was_done_and_what_was_before() -> None:
    episodes = drawn_episodes(40)
    policy = RecurrentPolicy(SETTINGS)
    losses = clone_sequences(policy, episodes, CLONING)
    assert losses[-1] < 0.25 * losses[0]
    assert clone_sequences(RecurrentPolicy(SETTINGS), episodes, CLONING) == losses
    few = clone_sequences(RecurrentPolicy(SETTINGS), episodes, replace(CLONING, epochs=2, updates=17))
    assert len(few) == 4  # of five batches each
    assert not policy.network.training


def test_the_scale_is_that_of_the_first_episodes() -> None:
    policy, episodes = RecurrentPolicy(SETTINGS), drawn_episodes()
    clone_sequences(policy, episodes, replace(CLONING, epochs=1))
    mean = policy.network.mean.clone()
    np.testing.assert_allclose(mean, np.concatenate([one.features for one in episodes]).mean(0), atol=1e-6)
    clone_sequences(policy, [replace(one, features=one.features + 3) for one in episodes], replace(CLONING, epochs=1))
    assert torch.equal(policy.network.mean, mean)


def test_hints_and_noise_count_where_they_are_asked_for() -> None:
    def first_loss(hints: int, **changed: float) -> float:
        policy = RecurrentPolicy(replace(SETTINGS, hints=hints))
        cloning = replace(CLONING, epochs=1, **changed)  # type: ignore[arg-type]
        return clone_sequences(policy, drawn_episodes(8, hints), cloning)[0]

    state = torch.get_rng_state()
    assert first_loss(2, hint_weight=10.0) > first_loss(2, hint_weight=0.1)
    assert first_loss(0, hint_weight=10.0) == first_loss(0, hint_weight=0.1)
    assert first_loss(0, noise=0.5) != first_loss(0)
    assert torch.equal(torch.get_rng_state(), state)


def test_bad_episodes_are_refused() -> None:
    policy, good = RecurrentPolicy(replace(SETTINGS, hints=3)), drawn_episodes(1, 3)[0]
    with pytest.raises(ValueError, match="at least one episode"):
        clone_sequences(policy, [], CLONING)
    with pytest.raises(ValueError, match="takes 12 features, 2 actions and 3 hints, got 11, 2 and 3"):
        clone_sequences(policy, [replace(good, features=good.features[:, :-1])], CLONING)
    with pytest.raises(ValueError, match="got 12, 2 and 1"):
        clone_sequences(policy, [replace(good, hints=good.hints[:, :1])], CLONING)
    with pytest.raises(ValueError, match="hints must be finite"):
        replace(good, hints=np.full_like(good.hints, np.nan))
    with pytest.raises(ValueError, match="as many features as actions"):
        replace(good, actions=good.actions[:-1])
    with pytest.raises(ValueError, match="epochs must be greater than or equal to 1, got 0"):
        SequenceCloningSettings(epochs=0)
