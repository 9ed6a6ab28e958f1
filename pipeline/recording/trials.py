"""Trials: episodes of a policy on held-out seeds, each in a log of its own, resumable episode by episode."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.episodes import EpisodeReader
from pipeline.episodes.records import EpisodeReadError
from pipeline.recording.record import record_episode

if TYPE_CHECKING:
    from cathsim import NavigateEnv
    from cathsim.metrics import EpisodeMetrics
    from enn.imitation.cloned_policy import ClonedPolicy
    from enn.policy import Policy

MODES = ("deterministic", "stochastic")
OPERATOR = "policy"
POLICY = "policy.pt"  # of a training of enn, in its folder

_LOGGER = logging.getLogger(__name__)

Controller = Callable[[Any, Mapping[str, Any]], np.ndarray]  # observation, info -> action; `reset()` where it has one


@dataclass(frozen=True)
class Origin:
    """Where a log comes from: what the report's tables group by."""

    stage: str
    row: str  # of the stage's table, e.g. "I+V+M" or "ppo_image"
    training_seed: int
    variant: str  # "thesis" or "desk"
    further: Mapping[str, Any] = field(default_factory=dict)  # whatever else is worth keeping

    def configuration(self, mode: str) -> dict[str, Any]:
        """As the log's configuration holds it."""
        return {
            "stage": self.stage,
            "row": self.row,
            "mode": mode,
            "training_seed": self.training_seed,
            "variant": self.variant,
            **self.further,
        }


def controllers(policy: Policy | ClonedPolicy, mode: str) -> Callable[[int], Controller]:
    """What gives a policy for the episode of a seed, as `run_trials` wants it."""
    return lambda seed: policy.controller(deterministic=mode == MODES[0], seed=seed)


def retrying(controller: Callable[[int], Controller], steps: int, attempts: int) -> Callable[[int], Controller]:
    """The same, with so many attempts of so many steps at an episode, as of `enn.retrying`; one: as it was."""
    if attempts == 1:
        return controller
    from enn.retrying import RetryingController

    return lambda seed: RetryingController(controller, steps, attempts, seed)


def run_trials(
    environment: NavigateEnv,
    controller: Callable[[int], Controller],
    folder: Path,
    *,
    seeds: Sequence[int],
    mode: str,
    origin: Origin,
    pictures: bool = False,
    report: Callable[[float, str], None] = lambda fraction, text: None,
) -> list[EpisodeMetrics]:
    """Records one episode a seed; those whose log is there already are not repeated.

    Args:
        controller: gives the policy for the episode of a seed, so that no episode depends on those before it.
        folder: gets ``000.mcap``, ``001.mcap``, …
        seeds: of the episodes' starts, and of the policy's draws.
        mode: "deterministic" or "stochastic"; kept in the log.

    Returns:
        An episode's metrics each, in the order of the seeds.

    Raises:
        ValueError: an unknown mode.
    """
    if mode not in MODES:
        raise ValueError(f"unknown mode '{mode}'; there are {', '.join(MODES)}")
    metrics: list[EpisodeMetrics] = []
    for index, seed in enumerate(seeds):
        path = folder / f"{index:03d}.mcap"
        known = recorded(path, seed)
        metrics.append(
            known
            or record_episode(
                environment,
                controller(seed),
                path,
                seed=seed,
                operator=OPERATOR,
                configuration=origin.configuration(mode),
                pictures=pictures,
            )
        )
        won = sum(episode.success for episode in metrics)
        report((index + 1) / len(seeds), f"{won}/{index + 1}")
    return metrics


def recorded(path: Path, seed: int) -> EpisodeMetrics | None:
    """The metrics of a log that an interrupted run has left; None where there is no whole log of that seed."""
    from cathsim.metrics import EpisodeMetrics

    if not path.exists():
        return None
    try:
        with EpisodeReader(path) as log:
            return EpisodeMetrics(**log.outcome.metrics) if log.info.seed == seed else None
    except (EpisodeReadError, TypeError):
        return None


def log_success(outcomes: Mapping[str, Mapping[str, Any]]) -> None:
    """Logs what each of some jobs made of its deterministic episodes, by their `summary`, where it played some."""
    for name, outcome in outcomes.items():
        if cells := outcome.get(MODES[0]):
            words = "%s: success %.0f %%, force %.2g N, %d episodes"
            _LOGGER.info(words, name, cells["success_pct"], cells["force_n"], cells["n"])


def summary(metrics: Sequence[EpisodeMetrics]) -> dict[str, Any]:
    """Success in %, median depth in mm, mean length in steps, mean and largest force in N, number of trials, not 0."""
    from cathsim.metrics import median_depth_mm

    return {
        "success_pct": 100.0 * float(np.mean([episode.success for episode in metrics])),
        "depth_mm": median_depth_mm(metrics),
        "episode_length_steps": float(np.mean([episode.steps for episode in metrics])),
        "force_n": float(np.mean([episode.force_mean for episode in metrics])),
        "force_max_n": float(np.max([episode.force_max for episode in metrics])),
        "n": len(metrics),
    }
