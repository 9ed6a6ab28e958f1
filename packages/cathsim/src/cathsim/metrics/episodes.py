"""Navigation metrics: force, path length, episode length, safety, success and SPL, as the thesis defines them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

FORCE_LIMIT = 2.0  # N, at which a step counts as unsafe
ENDING = ("branch", "depth", "success_lumen")  # fields that the last step's `info` has


Z_95 = 1.959964  # two-sided 95 % of the normal distribution


def force_magnitudes(forces: ArrayLike) -> Array:
    """Force magnitude (T,) N of each step from magnitudes (T,) N, or from vectors (T, 3) N in any one frame.

    Raises:
        ValueError: for another shape, or a force that is negative or not finite.

    Source: thesis, section Evaluation Metrics, Force.
    """
    array = np.asarray(forces, dtype=np.float64)
    if array.ndim == 2 and array.shape[1] == 3:
        array = np.linalg.norm(array, axis=1)
    if array.ndim != 1:
        raise ValueError(f"forces must have shape (T,) or (T, 3), got {array.shape}.")
    if not np.isfinite(array).all() or (array < 0).any():
        raise ValueError("force magnitudes must be finite and not negative; drop episodes whose simulation diverged.")
    return array


def path_length(tips: ArrayLike) -> float:
    """Length (m) of the way the tip went, from its positions (T + 1, 3) m from the reset on.

    Raises:
        ValueError: for another shape or positions that are not finite.

    Source: thesis, section Evaluation Metrics, Path Length.
    """
    array = np.asarray(tips, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3 or len(array) < 1 or not np.isfinite(array).all():
        raise ValueError(f"tip positions must be finite with shape (T + 1, 3), got shape {array.shape}.")
    return float(np.linalg.norm(np.diff(array, axis=0), axis=1).sum())


def safety(forces: ArrayLike, *, limit: float = FORCE_LIMIT) -> float:
    """Share (0 to 1) of the steps whose force stays below the limit; 1 for an episode without steps.

    Args:
        forces: (T,) N magnitudes, or (T, 3) N vectors.
        limit: N; a force that equals it is unsafe.

    Source: thesis, section Evaluation Metrics, Safety.
    """
    magnitudes = force_magnitudes(forces)
    return float(1.0 - np.mean(magnitudes >= limit)) if len(magnitudes) else 1.0


def spl(success: ArrayLike, paths: ArrayLike, shortest: ArrayLike) -> float:
    """Success weighted by path length, 0 to 1.

    Args:
        success: (N,) whether each episode reached its target.
        paths: (N,) m, length of each episode's way.
        shortest: (N,) or one number, m, the optimal length of each episode; ignored where the episode failed.

    Raises:
        ValueError: for no episodes, lengths that do not match, or a successful episode without an optimal length.

    Source: thesis, section Evaluation Metrics, SPL.
    """
    reached = np.asarray(success, dtype=bool)
    gone = np.asarray(paths, dtype=np.float64)
    if reached.ndim != 1 or len(reached) == 0 or gone.shape != reached.shape:
        raise ValueError(
            f"SPL needs one success and one path length for each of at least one episode, "
            f"got shapes {reached.shape} and {gone.shape}."
        )
    optimal = np.broadcast_to(np.asarray(shortest, dtype=np.float64), reached.shape)
    if not ((optimal[reached] >= 0).all() and np.isfinite(optimal[reached]).all() and (gone[reached] >= 0).all()):
        raise ValueError("SPL needs a finite optimal length, not negative, for every successful episode.")
    longer = np.maximum(gone, optimal)
    weights = np.zeros(len(reached))
    weights[reached] = 1.0  # also where both lengths are nought
    np.divide(optimal, longer, out=weights, where=reached & (longer > 0))
    return float(weights.mean())


@dataclass(frozen=True)
class EpisodeMetrics:
    """What one episode came to."""

    target: str  # the vessel aimed at; SPL compares episodes of one target
    force_mean: float  # N, over the steps
    force_max: float  # N, over the steps
    force_p95: float  # N, 95th percentile over the steps
    path_length: float  # m
    steps: int  # number of steps
    safety: float  # share of steps below the force limit, 0 to 1
    success: bool  # whether the target was reached in time
    reward: float  # sum over the steps
    # The next three describe the last step; episodes that were logged without them leave them unknown.
    branch: str = ""  # in which the tip is
    depth: float | None = None  # of the tip behind the branch's ostium, m
    success_lumen: bool | None = None  # whether the target was reached along the lumen

    @classmethod
    def from_arrays(
        cls,
        tips: ArrayLike,
        forces: ArrayLike,
        rewards: ArrayLike,
        success: bool,
        *,
        target: str = "",
        force_limit: float = FORCE_LIMIT,
        ending: Mapping[str, Any] | None = None,
    ) -> EpisodeMetrics:
        """Metrics of an episode from what it recorded.

        Args:
            tips: (T + 1, 3) m, tip positions from the reset on.
            forces: (T,) N magnitudes, or (T, 3) N resultant vectors.
            rewards: (T,).
            success: whether the target was reached in time.
            force_limit: N, at which a step counts as unsafe.
            ending: `info` of the last step, with `branch`, `depth` and `success_lumen`.

        Raises:
            ValueError: for arrays of unequal length, no step, or values that are not finite.
        """
        magnitudes = force_magnitudes(forces)
        earned = np.asarray(rewards, dtype=np.float64)
        length = path_length(tips)
        steps = len(magnitudes)
        if steps == 0 or earned.shape != (steps,) or len(np.asarray(tips)) != steps + 1:
            raise ValueError(
                "an episode of T >= 1 steps needs T forces, T rewards and T + 1 tip positions, "
                f"got {steps}, {earned.shape} and {len(np.asarray(tips))}."
            )
        if not np.isfinite(earned).all():
            raise ValueError("rewards must be finite; drop episodes whose simulation diverged.")
        return cls(
            target=target,
            force_mean=float(magnitudes.mean()),
            force_max=float(magnitudes.max()),
            force_p95=float(np.percentile(magnitudes, 95)),
            path_length=length,
            steps=steps,
            safety=safety(magnitudes, limit=force_limit),
            success=bool(success),
            reward=float(earned.sum()),
            **{name: ending[name] for name in ENDING if ending is not None and name in ending},
        )


@dataclass(frozen=True)
class Statistic:
    """Mean and standard deviation over episodes (of the population, n in the denominator)."""

    mean: float
    sd: float

    @classmethod
    def of(cls, values: ArrayLike) -> Statistic:
        """Mean and standard deviation of a sample (N,), N >= 1, in its unit."""
        array = np.asarray(values, dtype=np.float64)
        return cls(float(array.mean()), float(array.std()))

    def __str__(self) -> str:
        return f"{self.mean:.4g} ± {self.sd:.2g}"


@dataclass(frozen=True)
class Summary:
    """Metrics over episodes, in the columns and units of the thesis's tables, with what these leave out."""

    episodes: int  # how many
    force_n: Statistic  # mean force of an episode, N
    force_max_n: Statistic  # largest force of an episode, N
    force_p95_n: Statistic  # 95th percentile of the force in an episode, N
    path_length_cm: Statistic  # cm
    episode_length_steps: Statistic  # steps
    safety_pct: Statistic  # %
    success_pct: Statistic  # %, by the rule of the task
    success_lumen_pct: Statistic | None  # %, along the lumen; None where it is unknown of an episode
    depth_mm: float | None  # median of the tip's depth behind an ostium at the end, mm; None likewise
    spl_pct: float  # %, one number for all episodes
    reward: Statistic  # sum over an episode

    def as_dict(self) -> dict[str, list[float] | float | int | None]:
        """Columns by name, [mean, sd] each, as plain numbers for JSON."""
        return {
            name: [value.mean, value.sd] if isinstance(value, Statistic) else value
            for name, value in vars(self).items()
        }


def shortest_successful_paths(episodes: Sequence[EpisodeMetrics]) -> dict[str, float]:
    """Shortest path length (m) by target among the successful episodes, of every policy that is compared."""
    shortest: dict[str, float] = {}
    for episode in episodes:
        if episode.success:
            shortest[episode.target] = min(episode.path_length, shortest.get(episode.target, np.inf))
    return shortest


def _lumen_pct(episodes: Sequence[EpisodeMetrics]) -> Statistic | None:
    reached = [episode.success_lumen for episode in episodes]
    return None if None in reached else Statistic.of([100.0 * bool(one) for one in reached])


def median_depth_mm(episodes: Sequence[EpisodeMetrics]) -> float | None:
    """Median depth (mm) behind an ostium in which episodes ended; None where that is unknown of one."""
    depths = [episode.depth for episode in episodes if episode.depth is not None]
    return None if len(depths) < len(episodes) else 1e3 * median(depths)


def summarise(
    episodes: Sequence[EpisodeMetrics], *, shortest: Mapping[str, float] | Sequence[float] | None = None
) -> Summary:
    """Mean and standard deviation of every metric over episodes.

    Args:
        episodes: at least one.
        shortest: optimal path length for SPL, m: by target, or one for each episode, or None for the shortest
            successful path among these episodes. Policies compare fairly only under the same optimum: pass
            `shortest_successful_paths` of all of them.

    Raises:
        ValueError: without episodes, or when an optimal length is missing for a successful one.
    """
    if not episodes:
        raise ValueError("a summary needs at least one episode, got none.")
    if shortest is None:
        shortest = shortest_successful_paths(episodes)
    if isinstance(shortest, Mapping):
        missing = {e.target for e in episodes if e.success} - shortest.keys()
        if missing:
            raise ValueError(f"no optimal path length for target {', '.join(map(repr, sorted(missing)))}: add it.")
        optimal = [shortest.get(episode.target, np.nan) for episode in episodes]
    else:
        optimal = list(shortest)
        if len(optimal) != len(episodes):
            raise ValueError(f"expected one optimal length for each of {len(episodes)} episodes, got {len(optimal)}.")
    success = [episode.success for episode in episodes]
    paths = np.array([episode.path_length for episode in episodes])
    return Summary(
        episodes=len(episodes),
        force_n=Statistic.of([episode.force_mean for episode in episodes]),
        force_max_n=Statistic.of([episode.force_max for episode in episodes]),
        force_p95_n=Statistic.of([episode.force_p95 for episode in episodes]),
        path_length_cm=Statistic.of(100 * paths),
        episode_length_steps=Statistic.of([episode.steps for episode in episodes]),
        safety_pct=Statistic.of([100 * episode.safety for episode in episodes]),
        success_pct=Statistic.of([100.0 * s for s in success]),
        success_lumen_pct=_lumen_pct(episodes),
        depth_mm=median_depth_mm(episodes),
        spl_pct=100 * spl(success, paths, optimal),
        reward=Statistic.of([episode.reward for episode in episodes]),
    )


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """Computes Wilson's 95 % interval of a share.

    Args:
        successes: 0 to `trials`.
        trials: at least one; taken as independent.

    Returns:
        Lower and upper bound, 0 to 1.

    Raises:
        ValueError: for no trials, or more successes than trials.

    Source: Wilson 1927, "Probable inference, the law of succession, and statistical inference".
    """
    if not 0 <= successes <= trials or trials < 1:
        raise ValueError(f"expected 0 to n successes of n >= 1 trials, got {successes} of {trials}")
    share, square = successes / trials, Z_95**2
    centre = (share + square / (2 * trials)) / (1 + square / trials)
    half = Z_95 / (1 + square / trials) * math.sqrt(share * (1 - share) / trials + square / (4 * trials**2))
    # at the ends one bound is the share itself, which rounding may miss
    return (0.0 if successes == 0 else centre - half), (1.0 if successes == trials else centre + half)
