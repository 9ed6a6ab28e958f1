"""Evaluation during training: episodes from fixed seeds, played side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from enn.policy import Policy


@dataclass(frozen=True)
class EpisodeOutcome:
    """How one episode went."""

    success: bool
    steps: int
    reward: float  # their sum
    path_mm: float  # path length of the tip; 0 where the environment's info has no `tip`
    force_mean: float  # mean contact force, N
    force_max: float  # largest contact force, N


@dataclass(frozen=True)
class EvaluationResult:
    """What a policy reached over episodes."""

    outcomes: tuple[EpisodeOutcome, ...]

    @property
    def success(self) -> float:
        """Share of the episodes that reached the target."""
        return self._mean("success")

    @property
    def steps(self) -> float:
        """Mean length of an episode, in environment steps."""
        return self._mean("steps")

    @property
    def reward(self) -> float:
        """Mean sum of an episode's rewards."""
        return self._mean("reward")

    @property
    def path_mm(self) -> float:
        """Mean path length of the tip, mm."""
        return self._mean("path_mm")

    @property
    def force_mean(self) -> float:
        """Mean contact force over the episodes, N."""
        return self._mean("force_mean")

    @property
    def force_max(self) -> float:
        """Largest contact force of any episode, N."""
        return max(outcome.force_max for outcome in self.outcomes)

    def _mean(self, name: str) -> float:
        return float(np.mean([getattr(outcome, name) for outcome in self.outcomes]))


def run_episodes(
    policy: Policy,
    envs: Sequence[gymnasium.Env[Any, Any]],
    seeds: Sequence[int],
    *,
    deterministic: bool,
    tick: Callable[[], None] | None = None,
) -> EvaluationResult:
    """Plays one episode from each seed, as many side by side as there are environments.

    Args:
        envs: environments to play in; they are reset.
        seeds: of the episodes; the same seeds give the same episodes.
    """
    generator = np.random.default_rng(list(seeds))
    outcomes: dict[int, EpisodeOutcome] = {}
    waiting = list(enumerate(seeds))
    running: list[_RunningEpisode] = []
    for env in envs:
        if waiting:
            running.append(_RunningEpisode(env, *waiting.pop(0)))
    while running:
        first = running[0].observation
        if isinstance(first, dict):
            batch: Any = {key: np.stack([one.observation[key] for one in running]) for key in policy.keys}
        else:
            batch = np.stack([one.observation for one in running])
        actions = policy.act_batch(batch, deterministic, generator)
        still = []
        for one, action in zip(running, actions, strict=True):
            outcome = one.hold(action, policy.action_repeat)
            if outcome is None:
                still.append(one)
            else:
                outcomes[one.number] = outcome
                if waiting:
                    still.append(_RunningEpisode(one.env, *waiting.pop(0)))
        running = still
        if tick is not None:
            tick()
    return EvaluationResult(tuple(outcomes[number] for number in range(len(seeds))))


class _RunningEpisode:
    def __init__(self, env: gymnasium.Env[Any, Any], number: int, seed: int) -> None:
        self.env, self.number = env, number
        self.observation, info = env.reset(seed=seed)
        tip = info.get("tip")
        self._tip = None if tip is None else np.array(tip)
        self._steps, self._reward, self._path = 0, 0.0, 0.0
        self._forces: list[float] = []

    def hold(self, action: np.ndarray, repeat: int) -> EpisodeOutcome | None:
        """Plays an action for some steps; the outcome once the episode has ended."""
        for _ in range(repeat):
            self.observation, reward, terminated, truncated, info = self.env.step(action)
            self._steps += 1
            self._reward += float(reward)
            self._forces.append(float(info.get("force", 0.0)))
            tip = info.get("tip")
            if tip is not None and self._tip is not None:
                self._path += float(np.linalg.norm(tip - self._tip))
            self._tip = None if tip is None else np.array(tip)
            if terminated or truncated:
                success = bool(info.get("success", terminated))
                forces = np.array(self._forces)
                return EpisodeOutcome(
                    success, self._steps, self._reward, 1000 * self._path, float(forces.mean()), float(forces.max())
                )
        return None
