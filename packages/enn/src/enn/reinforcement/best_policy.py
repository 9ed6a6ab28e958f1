"""Best-policy selection: which policy of a training is the best, and when no better one is to be expected."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium
from torch import nn

from enn.policy import Policy
from enn.reinforcement.evaluation import EvaluationResult, run_episodes

EVALUATION_SEEDS, SEEDS_A_TRAINING = 500_000, 1_000  # of evaluations while training: tables need other ones
SCOUTS, SCOUT_SHARE = 3, 0.25  # evaluation episodes, at least so many, of which one has to succeed for the others
SHORTER = 0.98  # an evaluation is shorter than the best when its length is below this share
PERFECT, NEARLY = 0.999, 0.95


class BestPolicy:
    """Evaluates a policy and keeps the best weights.

    The best has the highest deterministic success, then the highest stochastic success, then the shortest way of
    the tip; among those that never arrive, it has the highest reward.

    Args:
        episodes: deterministic episodes, and as many stochastic ones where those were no worse than the best so far.
        seed: of the training; its evaluations play the same episodes every time.
    """

    def __init__(self, episodes: int, seed: int) -> None:
        first = EVALUATION_SEEDS + SEEDS_A_TRAINING * seed
        self.seeds = range(first, first + episodes)
        self.best: dict[str, Any] | None = None
        self.perfect = 0  # evaluations in a row that were perfect and no shorter than the best
        self.evaluated_at = -1  # decisions at the last evaluation

    @property
    def success(self) -> float | None:
        """Deterministic success of the best policy; None before the first evaluation."""
        return None if self.best is None else float(self.best["evaluation"]["success"])

    def evaluate(
        self,
        policy: Policy,
        envs: Sequence[gymnasium.Env[Any, Any]],
        decisions: int,
        tick: Callable[[], None] | None = None,
    ) -> dict[str, Any]:
        """Evaluates a policy and keeps its weights if it is the best so far.

        Args:
            envs: to play in; they are reset.

        Returns:
            Columns of the training's curve.
        """
        # failures last longest: a policy that fails a few times in a row is not worth the rest
        scouts = max(SCOUTS, round(SCOUT_SHARE * len(self.seeds)))  # over many anatomies three can be hard ones
        mean = run_episodes(policy, envs, self.seeds[:scouts], deterministic=True, tick=tick)
        if mean.success > 0 and len(self.seeds) > scouts:
            rest = run_episodes(policy, envs, self.seeds[scouts:], deterministic=True, tick=tick)
            mean = EvaluationResult((*mean.outcomes, *rest.outcomes))
        drawn: EvaluationResult | None = None
        if mean.success > 0 and mean.success >= (self.success or 0.0):
            drawn = run_episodes(policy, envs, self.seeds, deterministic=False, tick=tick)
        stochastic = 0.0 if drawn is None else drawn.success
        shorter = self.best is None or mean.steps < SHORTER * self.best["evaluation"]["steps"]
        perfect = mean.success >= PERFECT and stochastic >= NEARLY
        self.perfect = (1 if shorter else self.perfect + 1) if perfect else 0
        rank = (mean.success, stochastic, -mean.path_mm if mean.success > 0 else mean.reward)
        if self.best is None or rank > self.best["rank"]:
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
        self.evaluated_at = decisions
        return {
            "evaluation_success": mean.success,
            "evaluation_stochastic_success": None if drawn is None else stochastic,
            "evaluation_length": mean.steps,
            "evaluation_path_mm": mean.path_mm,
            "evaluation_force": mean.force_mean,
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
