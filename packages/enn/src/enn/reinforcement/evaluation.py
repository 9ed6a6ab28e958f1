"""Evaluation during training: episodes from fixed seeds, played side by side, and best-policy selection by them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from torch import nn

from enn.policy import Policy
from enn.reinforcement.resources import Workers

EVALUATION_SEEDS, SEEDS_A_TRAINING = 500_000, 1_000  # of evaluations while training: tables need other ones
SCOUTS, SCOUT_SHARE = 3, 0.25  # evaluation episodes, at least so many, of which one has to succeed for the others
SHORTER = 0.98  # an evaluation is shorter than the best when its length is below this share
PERFECT, NEARLY = 0.999, 0.95


@dataclass(frozen=True)
class EpisodeOutcome:
    """How one episode went."""

    success: bool
    steps: int
    reward: float  # their sum
    path_mm: float  # path length of the tip; 0 where the environment's info has no `tip`
    force_mean: float  # mean contact force, N
    force_max: float  # largest contact force, N


def _mean_of(name: str, doc: str) -> Any:
    return property(lambda result: float(np.mean([getattr(one, name) for one in result.outcomes])), doc=doc)


@dataclass(frozen=True)
class EvaluationResult:
    """What a policy reached over episodes."""

    outcomes: tuple[EpisodeOutcome, ...]

    success = _mean_of("success", "Share of the episodes that reached the target.")
    steps = _mean_of("steps", "Mean length of an episode, in environment steps.")
    reward = _mean_of("reward", "Mean sum of an episode's rewards.")
    path_mm = _mean_of("path_mm", "Mean path length of the tip, mm.")
    force_mean = _mean_of("force_mean", "Mean contact force over the episodes, N.")

    @property
    def force_max(self) -> float:
        """Largest contact force of any episode, N."""
        return max(outcome.force_max for outcome in self.outcomes)


def run_episodes(
    policy: Policy,
    envs: Sequence[gymnasium.Env[Any, Any]],
    seeds: Sequence[int],
    *,
    deterministic: bool,
    tick: Callable[[], None] | None = None,
    workers: Workers | None = None,
) -> EvaluationResult:
    """Plays one episode from each seed, as many side by side as there are environments.

    Args:
        envs: environments to play in; they are reset.
        seeds: of the episodes; the same seeds give the same episodes.
        workers: threads that step them; None: this one alone.
    """
    workers = workers or Workers()
    generator = np.random.default_rng(list(seeds))
    outcomes: dict[int, EpisodeOutcome] = {}
    waiting = list(enumerate(seeds))
    count = min(len(envs), len(waiting))
    running: list[_RunningEpisode] = workers.each(lambda k: _RunningEpisode(envs[k], *waiting[k]), range(count))
    del waiting[:count]
    while running:
        first = running[0].observation
        if isinstance(first, dict):
            batch: Any = {key: np.stack([one.observation[key] for one in running]) for key in policy.keys}
        else:
            batch = np.stack([one.observation for one in running])
        actions = policy.act_batch(batch, deterministic, generator)
        held = workers.each(partial(_held, running, actions, policy.action_repeat), range(len(running)))
        still = []
        for one, outcome in zip(running, held, strict=True):
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


def _held(running: Sequence[_RunningEpisode], actions: Any, repeat: int, index: int) -> EpisodeOutcome | None:
    return running[index].hold(actions[index], repeat)


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


class BestPolicy:
    """Evaluates a policy, keeps the best weights, and says when no better ones are to be expected.

    The best has the highest deterministic success, then the highest stochastic success, then the shortest way of
    the tip; among those that never arrive, it has the highest reward.

    Args:
        episodes: deterministic episodes, and as many stochastic ones where those were no worse than the best so far.
        seed: of the training; its evaluations play the same episodes every time.
        keeps_first: the policy evaluated first remains the best until another one arrives: rewards of episodes that
            all fail do not say that it became better.
    """

    def __init__(self, episodes: int, seed: int, *, keeps_first: bool = False) -> None:
        first = EVALUATION_SEEDS + SEEDS_A_TRAINING * seed
        self.seeds = range(first, first + episodes)
        self.keeps_first = keeps_first
        self.best: dict[str, Any] | None = None
        self.perfect = 0  # evaluations in a row that were perfect and no shorter than the best
        self.evaluated_at = -1  # decisions at the last evaluation

    @property
    def success(self) -> float | None:
        """Success of the kept policy, of its best actions where these are played; None before the first evaluation."""
        return None if self.best is None else float(self.best["evaluation"]["success"])

    def evaluate(
        self,
        policy: Policy,
        envs: Sequence[gymnasium.Env[Any, Any]],
        decisions: int,
        tick: Callable[[], None] | None = None,
        workers: Workers | None = None,
    ) -> dict[str, Any]:
        """Evaluates a policy and keeps its weights if it is the best so far.

        Args:
            envs: to play in; they are reset.
            workers: threads that step them.

        Returns:
            Columns of the training's curve.
        """
        mean = self.play(policy, envs, tick, workers, deterministic=True)
        drawn: EvaluationResult | None = None
        if mean.success > 0 and mean.success >= (self.success or 0.0):
            drawn = run_episodes(policy, envs, self.seeds, deterministic=False, tick=tick, workers=workers)
        stochastic = 0.0 if drawn is None else drawn.success
        self._count_perfect(mean, mean.success >= PERFECT and stochastic >= NEARLY)
        rank = (mean.success, stochastic, -mean.path_mm if mean.success > 0 else mean.reward)
        compared = mean.success > 0 or not self.keeps_first
        if self.best is None or (compared and rank > self.best["rank"]):
            self._keep(policy, rank, mean, stochastic, decisions)
        self.evaluated_at = decisions
        return _columns(mean, None if drawn is None else stochastic)

    def play(
        self,
        policy: Policy,
        envs: Sequence[gymnasium.Env[Any, Any]],
        tick: Callable[[], None] | None = None,
        workers: Workers | None = None,
        *,
        deterministic: bool,
    ) -> EvaluationResult:
        """Plays the episodes of an evaluation, of which only a few are played where all of these fail."""
        # failures last longest: a policy that fails a few times in a row is not worth the rest
        scouts = max(SCOUTS, round(SCOUT_SHARE * len(self.seeds)))  # over many anatomies three can be hard ones
        play = partial(run_episodes, policy, envs, deterministic=deterministic, tick=tick, workers=workers)
        mean = play(self.seeds[:scouts])
        if mean.success > 0 and len(self.seeds) > scouts:
            mean = EvaluationResult((*mean.outcomes, *play(self.seeds[scouts:]).outcomes))
        return mean

    def _count_perfect(self, mean: EvaluationResult, perfect: bool) -> None:
        shorter = self.best is None or mean.steps < SHORTER * self.best["evaluation"]["steps"]
        self.perfect = (1 if shorter else self.perfect + 1) if perfect else 0

    def _keep(
        self, policy: Policy, rank: tuple[float, ...], mean: EvaluationResult, stochastic: float, decisions: int
    ) -> None:
        self.best = {
            "rank": rank,
            "weights": {name: value.clone() for name, value in policy.module.state_dict().items()},
            "evaluation": {
                "success": mean.success,
                "stochastic_success": stochastic,
                "steps": mean.steps,
                "path_mm": mean.path_mm,
                "force_mean": mean.force_mean,
                "force_max": mean.force_max,
                "decisions": float(decisions),
            },
        }

    def load_best_into(self, module: nn.Module) -> dict[str, float] | None:
        """Loads the best weights into a network, if there are any; returns their evaluation."""
        if self.best is None:
            return None
        module.load_state_dict(self.best["weights"])
        return dict(self.best["evaluation"])

    def state(self) -> dict[str, Any]:
        """Best weights and counts, as plain data; for `restore`."""
        return {"best": self.best, "perfect": self.perfect, "evaluated_at": self.evaluated_at}

    def restore(self, state: dict[str, Any]) -> None:
        """Returns to a saved state."""
        self.best, self.perfect, self.evaluated_at = state["best"], state["perfect"], state["evaluated_at"]


class LatestPolicy(BestPolicy):
    """Evaluates a policy by drawn actions, and keeps the latest weights that are not clearly worse than the best.

    A training whose learning rate falls goes on to gain, by less than a few episodes tell: the best of several
    evaluations is mostly the luckiest. Clearly worse is a success that is lower by more than the standard error of
    the difference. Among those that never arrive, the one with the highest reward is kept, or the first with
    `keeps_first`. The policy that a training starts from is not among the perfect ones after which it stops early.

    Args:
        first: `play` of the policy that is evaluated first, by drawn actions; None: it is played here.
        episodes, seed, keeps_first: as of `BestPolicy`.
    """

    def __init__(
        self, episodes: int, seed: int, *, keeps_first: bool = False, first: EvaluationResult | None = None
    ) -> None:
        super().__init__(episodes, seed, keeps_first=keeps_first)
        self._first = first

    def evaluate(
        self,
        policy: Policy,
        envs: Sequence[gymnasium.Env[Any, Any]],
        decisions: int,
        tick: Callable[[], None] | None = None,
        workers: Workers | None = None,
    ) -> dict[str, Any]:
        """Evaluates a policy and keeps its weights unless it is clearly worse than the best so far.

        Args and returns as of `BestPolicy.evaluate`; both columns of success hold that of drawn actions.
        """
        played = self._first if self.evaluated_at < 0 else None
        mean = played or self.play(policy, envs, tick, workers, deterministic=False)
        self._count_perfect(mean, mean.success >= PERFECT and decisions > 0)
        highest = 0.0 if self.best is None else self.best["rank"][0]
        rank = (max(mean.success, highest), mean.reward)
        if self.best is None:
            keep = True
        elif highest > 0:
            keep = mean.success > 0 and mean.success >= highest - standard_error(highest, len(self.seeds))
        else:
            keep = mean.success > 0 or (not self.keeps_first and mean.reward > self.best["rank"][1])
        if keep:
            self._keep(policy, rank, mean, mean.success, decisions)
        self.evaluated_at = decisions
        return _columns(mean, mean.success)


def standard_error(share: float, episodes: int) -> float:
    """Standard error of the difference of two shares near this one, of so many episodes each.

    With one success and one failure more than there were, so that it is not 0 where all succeeded (Agresti and Coull
    1998 add two of each).
    """
    smoothed = (share * episodes + 1) / (episodes + 2)
    return float(np.sqrt(2 * smoothed * (1 - smoothed) / episodes))


def _columns(mean: EvaluationResult, stochastic: float | None) -> dict[str, Any]:
    return {
        "evaluation_success": mean.success,
        "evaluation_stochastic_success": stochastic,
        "evaluation_length": mean.steps,
        "evaluation_path_mm": mean.path_mm,
        "evaluation_force": mean.force_mean,
    }
