"""Lessons for the image student: episodes that expert or student steer while the expert says what it would do."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from enn.devices import device_of
from enn.imitation.recurrent_policy import ImageStudent, Lesson
from enn.policy import Policy


def give_lessons(
    envs: Sequence[gymnasium.Env[Any, Any]],
    expert: Policy,
    student: ImageStudent,
    seeds: Sequence[int],
    *,
    expert_share: float,
    noise: float = 0.0,
    generator: np.random.Generator,
    tick: Callable[[], None] | None = None,
) -> list[Lesson]:
    """Plays an episode from each seed, as many side by side as there are environments.

    Args:
        envs: with the student's keys and the expert's one observation among their observations; they are reset.
        expert: says at each decision what it would do; its first key is what the student learns to tell as hints.
        student: steers the episodes that the expert does not; its action repeat must be the expert's.
        seeds: of the episodes.
        expert_share: share of the episodes that the expert steers.
        noise: standard deviation of what is added to the actions that are carried out; never to the lesson's.
        generator: of who steers and of the noise.
        tick: called after every decision.

    Returns:
        The lessons, in the order in which the episodes ended.

    Raises:
        ValueError: expert and student hold their actions for different numbers of steps.
    """
    if expert.action_repeat != student.action_repeat:
        raise ValueError(
            f"expert and student must hold actions equally long, got {expert.action_repeat} and {student.action_repeat}"
        )
    waiting = list(seeds)
    running = [_Pupil(env, student, waiting.pop(0), generator.random() < expert_share) for env in envs if waiting]
    lessons: list[Lesson] = []
    while running:
        batch = {key: np.stack([one.observation[key] for one in running]) for key in expert.keys}
        advice = expert.act_batch(batch, deterministic=True)
        views = np.stack([one.look() for one in running])
        memory = _stacked([one.memory for one in running], student)
        own, memory = student.act(views, memory)
        still = []
        for index, one in enumerate(running):
            one.memory = memory[:, index : index + 1].clone()
            action = advice[index] if one.by_expert else own[index]
            if noise:
                action = np.clip(action + generator.normal(0.0, noise, action.shape), -1.0, 1.0).astype(np.float32)
            lesson = one.hold(action, views[index], advice[index], batch[expert.keys[0]][index])
            if lesson is None:
                still.append(one)
                continue
            lessons.append(lesson)
            if waiting:
                still.append(_Pupil(one.env, student, waiting.pop(0), generator.random() < expert_share))
        running = still
        if tick is not None:
            tick()
    return lessons


def _stacked(memories: list[Tensor | None], student: ImageStudent) -> Tensor:
    import torch

    empty = torch.zeros(1, 1, student.settings.hidden, device=device_of(student.network))
    return torch.cat([empty if memory is None else memory for memory in memories], 1)


class _Pupil:
    """An episode in the making."""

    def __init__(self, env: gymnasium.Env[Any, Any], student: ImageStudent, seed: int, by_expert: bool) -> None:
        self.env, self.student, self.by_expert = env, student, by_expert
        self.observation, _ = env.reset(seed=seed)
        self.view = student.begin(self.observation)
        self.memory: Tensor | None = None
        self.action: NDArray[Any] = np.zeros(2, np.float32)
        self.rows: list[tuple[NDArray[Any], NDArray[Any], NDArray[Any]]] = []

    def look(self) -> NDArray[np.float32]:
        return self.view.look(self.observation["image"], self.student.mask(self.observation), self.action)

    def hold(self, action: NDArray[Any], view: NDArray[Any], advice: NDArray[Any], hint: NDArray[Any]) -> Lesson | None:
        """Carries an action out; the lesson once the episode has ended."""
        self.rows.append((view, advice.copy(), hint.astype(np.float32)))
        self.action = action
        for _ in range(self.student.action_repeat):
            self.observation, _, terminated, truncated, info = self.env.step(action)
            if terminated or truncated:
                views, actions, hints = (np.stack(part) for part in zip(*self.rows, strict=True))
                return Lesson(views, actions, hints, bool(info.get("success", terminated)))
        return None
