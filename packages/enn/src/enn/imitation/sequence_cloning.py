"""Cloning of whole episodes into a recurrent policy: an expert's own, or those that a teacher gave advice on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from enn.imitation.recurrent_policy import RecurrentPolicy
from enn.networks.devices import seeded
from enn.setting_kinds import Count, CountOrNone, LearningRate, Weight, settings

_SPREAD = 0.05  # added to each feature's standard deviation: what hardly varies must not become noise
_BEND = 0.3  # errors of actions above count linearly
_SAME_LENGTH = 8  # decisions: episodes that differ by less go together, so that little is padded


@settings
class SequenceCloningSettings:
    """How a recurrent policy is fitted to episodes.

    Attributes:
        epochs: passes over all episodes, at least.
        updates: at least so many; few episodes are passed over more often.
        learning_rate: of AdamW at its start; it falls to a tenth.
        noise: standard deviation of what is added to the features, in their own standard deviations.
        hint_weight: of the hints in the loss.
    """

    epochs: Count = 40
    updates: CountOrNone = 0
    batch_size: Count = 16
    learning_rate: LearningRate = 2e-3
    weight_decay: Weight = 0.0
    noise: Weight = 0.0
    hint_weight: Weight = 0.1

    def passes(self, episodes: int) -> int:
        """Passes over so many episodes."""
        return max(self.epochs, -(-self.updates // -(-episodes // self.batch_size)))


@dataclass(frozen=True, eq=False)
class AdvisedEpisode:
    """One episode: what the policy saw, and what was or should have been done.

    Attributes:
        features: (T, features).
        actions: (T, actions).
        hints: (T, hints) of the teacher's observation; (T, 0) without.
        success: whether the target was reached.
        target: that was to be reached.
    """

    features: NDArray[np.float32]
    actions: NDArray[np.float32]
    hints: NDArray[np.float32]
    success: bool
    target: str = ""

    def __post_init__(self) -> None:
        """Checks that the lengths agree and all is finite."""
        lengths = {len(self.features), len(self.actions), len(self.hints)}
        if len(lengths) != 1 or lengths == {0}:
            raise ValueError(f"an episode needs as many features as actions and hints, got lengths {sorted(lengths)}")
        for name in ("features", "actions", "hints"):
            if not np.isfinite(getattr(self, name)).all():
                raise ValueError(f"an episode's {name} must be finite: leave this episode out")


def clone_sequences(
    policy: RecurrentPolicy,
    episodes: Sequence[AdvisedEpisode],
    settings: SequenceCloningSettings,
    *,
    seed: int = 0,
    progress: Callable[[int, float], None] | None = None,
) -> list[float]:
    """Fits a policy in place, going on from the weights that it has.

    Args:
        policy: to be fitted; its features are scaled as in the first episodes that it is fitted to.
        seed: of order, noise and dropout.
        progress: called with each epoch's number, from 1, and mean loss.

    Returns:
        The mean loss of each epoch.

    Raises:
        ValueError: no episodes, or of other sizes than the policy's.
    """
    if not episodes:
        raise ValueError("a policy needs at least one episode to learn from")
    _require_sizes(policy, episodes)
    network = policy.network
    if not bool(network.scale.any()):
        every = np.concatenate([episode.features for episode in episodes])
        network.mean.copy_(torch.as_tensor(every.mean(0)))
        network.scale.copy_(torch.as_tensor(1.0 / (every.std(0) + _SPREAD)))
    generator = np.random.default_rng(seed)
    optimiser = torch.optim.AdamW(
        network.parameters(), settings.learning_rate, weight_decay=settings.weight_decay, fused=True
    )
    batches, passes = -(-len(episodes) // settings.batch_size), settings.passes(len(episodes))
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(
        optimiser, passes * batches, eta_min=settings.learning_rate / 10
    )
    losses = []
    with seeded(seed, policy.device):
        network.train()
        for epoch in range(passes):
            mixed = generator.permutation(len(episodes))
            order = sorted(mixed, key=lambda i: len(episodes[i].features) // _SAME_LENGTH)
            parts = np.array_split(np.array(order), batches)
            total = 0.0
            for k in generator.permutation(batches):
                loss = _loss(policy, [episodes[i] for i in parts[k]], settings)
                optimiser.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(network.parameters(), 1.0)
                optimiser.step()
                schedule.step()
                total += float(loss.detach()) / batches
            losses.append(total)
            if progress is not None:
                progress(epoch + 1, total)
    network.eval()
    return losses


def _require_sizes(policy: RecurrentPolicy, episodes: Sequence[AdvisedEpisode]) -> None:
    own = policy.settings
    for episode in episodes:
        sizes = [array.shape[1] for array in (episode.features, episode.actions, episode.hints)]
        if sizes[:2] != [own.features, own.actions] or (own.hints and sizes[2] != own.hints):
            raise ValueError(
                f"the policy takes {own.features} features, {own.actions} actions and {own.hints} hints, got "
                f"{sizes[0]}, {sizes[1]} and {sizes[2]}"
            )


def _loss(policy: RecurrentPolicy, episodes: Sequence[AdvisedEpisode], settings: SequenceCloningSettings) -> Tensor:
    features, expert_actions, hints, counted = (
        nn.utils.rnn.pad_sequence([torch.as_tensor(part) for part in parts], batch_first=True).to(policy.device)
        for parts in (
            [episode.features for episode in episodes],
            [episode.actions for episode in episodes],
            [episode.hints for episode in episodes],
            [np.ones(len(episode.features), np.float32) for episode in episodes],
        )
    )
    if settings.noise:
        noise = torch.randn(features.shape).to(policy.device)  # drawn on the CPU: the same on every device
        features = features + settings.noise * noise / policy.network.scale.clamp_min(1e-6)
    actions, predicted, _ = policy.network(features)
    error = functional.smooth_l1_loss(actions, expert_actions, reduction="none", beta=_BEND).sum(-1)
    if policy.settings.hints:
        error = error + settings.hint_weight * (predicted - hints.clamp(-3, 3)).square().mean(-1)
    return (error * counted).sum() / counted.sum()
