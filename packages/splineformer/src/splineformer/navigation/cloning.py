"""Training of the navigator: behaviour cloning of whole episodes, of an expert's own or of its advice to a student."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from guide3d.setting_kinds import Count, CountOrNone, LearningRate, Weight, settings
from splineformer.navigation.navigator import ACTIONS, Navigator

_SPREAD = 0.05  # added to each number's standard deviation: what hardly varies must not become noise
_BEND = 0.3  # errors of actions above count linearly
_SAME_LENGTH = 8  # decisions: episodes that differ by less go together


@settings
class CloningSettings:
    """How a navigator is fitted.

    Attributes:
        epochs: passes over all episodes, at least.
        updates: at least so many; few episodes are passed over the oftener.
        batch_size: episodes an update.
        learning_rate: of Adam at its start; it falls to a tenth.
        weight_decay: of the weights.
        noise: standard deviation of what is added to the looks, of their own.
        hint_weight: of the loss of the hints.
    """

    epochs: Count = 40
    updates: CountOrNone = 0
    batch_size: Count = 8
    learning_rate: LearningRate = 2e-3
    weight_decay: Weight = 1e-3
    noise: Weight = 0.05
    hint_weight: Weight = 0.1

    def passes(self, episodes: int) -> int:
        """Passes over so many episodes."""
        return max(self.epochs, -(-self.updates // -(-episodes // self.batch_size)))


# Of lessons, whose teacher knows more than the images show: to tell its roadmap teaches more than its actions alone.
LESSONS = CloningSettings(batch_size=16, weight_decay=0.1, noise=0.15, hint_weight=10.0)


@dataclass(frozen=True, eq=False)
class Episode:
    """One episode: what the navigator saw, and what was or should have been done.

    Attributes:
        looks: (T, size).
        actions: (T, 2).
        hints: (T, hints) of the teacher's observation; (T, 0) without.
        success: whether the target was reached.
        target: that was to be reached.
    """

    looks: NDArray[np.float32]
    actions: NDArray[np.float32]
    hints: NDArray[np.float32]
    success: bool
    target: str = ""

    def __post_init__(self) -> None:
        """Checks that the lengths agree and all is finite."""
        lengths = {len(self.looks), len(self.actions), len(self.hints)}
        if len(lengths) != 1 or lengths == {0}:
            raise ValueError(f"an episode needs as many looks as actions and hints, got lengths {sorted(lengths)}")
        for name in ("looks", "actions", "hints"):
            if not np.isfinite(getattr(self, name)).all():
                raise ValueError(f"an episode's {name} must be finite: leave this episode out")


def clone(
    navigator: Navigator,
    episodes: Sequence[Episode],
    settings: CloningSettings,
    *,
    seed: int = 0,
    progress: Callable[[int, float], None] | None = None,
) -> list[float]:
    """Fits a navigator in place, going on from the weights that it has.

    Args:
        navigator: to be fitted; the scale of its looks is that of the first episodes that it is fitted to.
        episodes: to learn from.
        settings: of the fit.
        seed: of order, noise and dropout.
        progress: called with each epoch's number, from 1, and mean loss.

    Returns:
        The mean loss of each epoch.

    Raises:
        ValueError: no episodes, or of other sizes than the navigator's.
    """
    network, size = navigator.network, navigator.settings.size
    if not episodes:
        raise ValueError("there is no episode to learn from")
    hints = navigator.settings.hints
    for episode in episodes:
        if episode.looks.shape[1:] != (size,) or episode.actions.shape[1:] != (ACTIONS,):
            raise ValueError(
                f"the navigator takes looks of {size} numbers and {ACTIONS} actions, got {episode.looks.shape[1:]} and "
                f"{episode.actions.shape[1:]}"
            )
        if hints and episode.hints.shape[1] != hints:
            raise ValueError(f"the navigator learns {hints} hints, got {episode.hints.shape[1]}")
    if not bool(network.scale.any()):
        every = np.concatenate([episode.looks for episode in episodes])
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
    with torch.random.fork_rng(devices=[navigator.device] if navigator.device.type == "cuda" else []):
        torch.manual_seed(seed)
        network.train()
        for epoch in range(passes):
            mixed = generator.permutation(len(episodes))
            order = sorted(mixed, key=lambda i: len(episodes[i].looks) // _SAME_LENGTH)
            parts = np.array_split(np.array(order), batches)
            total = 0.0
            for k in generator.permutation(batches):
                loss = _loss(navigator, [episodes[i] for i in parts[k]], settings)
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


def _loss(navigator: Navigator, episodes: Sequence[Episode], settings: CloningSettings) -> Tensor:
    network = navigator.network
    looks, wanted, hints, counted = (
        nn.utils.rnn.pad_sequence([torch.as_tensor(part) for part in parts], batch_first=True).to(navigator.device)
        for parts in (
            [episode.looks for episode in episodes],
            [episode.actions for episode in episodes],
            [episode.hints for episode in episodes],
            [np.ones(len(episode.looks), np.float32) for episode in episodes],
        )
    )
    if settings.noise:
        noise = torch.randn(looks.shape).to(navigator.device)  # drawn on the CPU: the same on every device
        looks = looks + settings.noise * noise / network.scale.clamp_min(1e-6)
    actions, told, _ = network(looks)
    error = functional.smooth_l1_loss(actions, wanted, reduction="none", beta=_BEND).sum(-1)
    if navigator.settings.hints:
        error = error + settings.hint_weight * (told - hints.clamp(-3, 3)).square().mean(-1)
    return (error * counted).sum() / counted.sum()
