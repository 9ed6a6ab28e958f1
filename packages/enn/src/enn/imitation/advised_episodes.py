"""Advised episodes: teacher or policy steers while the teacher says at each decision what it would do."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from enn.imitation.recurrent_policy import Begin, Perception, RecurrentPolicy, RecurrentPolicySettings
from enn.imitation.sequence_cloning import AdvisedEpisode
from enn.policy import Policy

SIDE_BY_SIDE = 12  # episodes played together, so that networks see them in batches


@dataclass(frozen=True)
class EpisodeStart:
    """An episode to be played.

    Attributes:
        environment: observes what the teacher and the perception see.
        begin: makes the perception's view from the first observation.
        done: called when the episode has ended.
    """

    environment: gymnasium.Env[Any, Any]
    seed: int
    begin: Begin
    done: Callable[[], None]
    target: str = ""


def play_advised(
    starts: Iterable[EpisodeStart],
    teacher: Policy,
    policy: RecurrentPolicy,
    perception: Perception,
    *,
    teacher_share: float,
    noise: float = 0.0,
    generator: np.random.Generator,
    hint_key: str | None = None,
    side_by_side: int = SIDE_BY_SIDE,
    tick: Callable[[int], None] = lambda finished: None,
) -> list[AdvisedEpisode]:
    """Plays episodes side by side while the teacher says at each decision what it would do.

    Args:
        starts: of the episodes, each taken when its turn comes.
        teacher: a policy on observations of its own; its advice is held as long as the policy's actions.
        policy: steers the episodes that the teacher does not.
        teacher_share: share of the episodes that the teacher steers.
        noise: standard deviation of what is added to the actions that are carried out, never to those learnt.
        generator: of who steers and of the noise.
        hint_key: observation of the teacher that the policy learns to predict; None: none.
        tick: called with the number of finished episodes after every decision.

    Returns:
        The episodes, in the order in which they ended.
    """
    waiting = iter(starts)
    episodes: list[AdvisedEpisode] = []

    def following(count: int) -> Iterator[_Running]:
        for _, start in zip(range(count), waiting, strict=False):
            yield _Running(start, generator.random() < teacher_share, policy.settings, hint_key)

    running = list(following(side_by_side))
    while running:
        advice = teacher.act_batch({key: np.stack([one.observation[key] for one in running]) for key in teacher.keys})
        features = perception(
            [one.view for one in running], [one.observation for one in running], [one.action for one in running]
        )
        own, states = policy.act(features, _joined([one.state for one in running], policy))
        still = []
        for index, one in enumerate(running):
            one.state = states[:, index : index + 1].clone()
            action = advice[index] if one.by_teacher else own[index]
            if noise:
                action = np.clip(action + generator.normal(0.0, noise, action.shape), -1.0, 1.0).astype(np.float32)
            if one.carries_out(action, features[index], advice[index]):
                still.append(one)
            else:
                episodes.append(one.episode())
                still += following(1)
        running = still
        tick(len(episodes))
    return episodes


def _joined(states: Sequence[Tensor | None], policy: RecurrentPolicy) -> Tensor:
    empty = torch.zeros(1, 1, policy.settings.hidden, device=policy.device)
    return torch.cat([empty if state is None else state for state in states], 1)


class _Running:
    """An episode under way."""

    def __init__(
        self, start: EpisodeStart, by_teacher: bool, settings: RecurrentPolicySettings, hint_key: str | None
    ) -> None:
        self.by_teacher = by_teacher
        self._start, self._repeat, self._hint_key = start, settings.action_repeat, hint_key
        self.observation, _ = start.environment.reset(seed=start.seed)
        self.view = start.begin(self.observation)
        self.state: Tensor | None = None
        self.action: NDArray[np.float32] = np.zeros(settings.actions, np.float32)
        self._rows: list[tuple[NDArray[Any], NDArray[Any], NDArray[Any]]] = []
        self._success = False

    def carries_out(self, action: NDArray[np.float32], features: NDArray[Any], advice: NDArray[Any]) -> bool:
        """Holds an action; whether the episode goes on."""
        hint = np.zeros(0) if self._hint_key is None else self.observation[self._hint_key]
        self._rows.append((features, advice.copy(), np.asarray(hint, np.float32)))
        self.action = action
        for _ in range(self._repeat):
            self.observation, _, terminated, truncated, info = self._start.environment.step(action)
            if terminated or truncated:
                self._success = bool(info.get("success", terminated))
                self._start.done()
                return False
        return True

    def episode(self) -> AdvisedEpisode:
        """What was seen and advised."""
        features, actions, hints = (np.stack(part) for part in zip(*self._rows, strict=True))
        return AdvisedEpisode(features, actions, hints, self._success, self._start.target)
