"""Contact forces of recorded episodes against a real distribution: samples from the logs, tests, a verdict in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.settings.checks import shown

SIGNIFICANCE = 0.05
SAFE_FORCE_N = 2.0
_SHAPIRO_LIMIT = 5000  # samples beyond which scipy no longer vouches for the p-value
_TESTABLE = 8  # samples, below which the tests say nothing

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EpisodeForces:
    """Contact forces of one logged episode.

    Attributes:
        phantom: its name.
        target: likewise.
        operator: who steered.
        free_force_n: force that the operator does not mind, N; None where the log says nothing of it.
        magnitudes: (T,) N, largest resultant of each step.
        points: (k, 3) m, contact positions of all steps, world frame.
        forces: (k,) N, their magnitudes.
    """

    phantom: str
    target: str
    operator: str
    free_force_n: float | None
    magnitudes: Array
    points: Array
    forces: Array


@dataclass(frozen=True)
class Comparison:
    """A sample of simulated forces against a normal distribution of real ones.

    Attributes:
        n: simulated samples, and as many drawn from the real distribution.
        mean_n, sd_n, median_n, p95_n, max_n: of the simulated forces, N.
        real_mean_n, real_sd_n: of the real distribution, N.
        contact_share: share of the steps with any contact force, 0 to 1.
        safe_share: share of the steps below 2 N, 0 to 1.
        u_statistic, mann_whitney_p: Mann-Whitney U test, two-sided.
        exceedance: U over n^2, the probability that a simulated force exceeds a real one.
        shapiro_p: Shapiro-Wilk test of the simulated forces for normality.
        levene_p: Levene test for equal variances.
    """

    n: int
    mean_n: float
    sd_n: float
    median_n: float
    p95_n: float
    max_n: float
    real_mean_n: float
    real_sd_n: float
    contact_share: float
    safe_share: float
    u_statistic: float
    mann_whitney_p: float
    exceedance: float
    shapiro_p: float
    levene_p: float


def read_forces(folder: Path) -> list[EpisodeForces]:
    """Reads the contact forces of every log below a folder.

    Args:
        folder: of a stage that recorded episodes.

    Returns:
        One entry a log, in the order of their paths. The state after reset, which is no step, is left out.
    """
    return [episode_forces(path) for path in sorted(folder.rglob("*.mcap"))]


def episode_forces(path: Path) -> EpisodeForces:
    """Reads the contact forces of one log.

    Args:
        path: of the log.

    Returns:
        Its forces. The state after reset, which is no step, is left out.
    """
    from pipeline.episodes import EpisodeReader, EpisodeReadError

    with EpisodeReader(path) as log:
        arrays, info = log.load_arrays(pictures=False), log.info
    steps = arrays["step"] > 0
    points = arrays["contact_positions"][steps].reshape(-1, 3)
    norms = np.linalg.norm(arrays["contact_forces"][steps].reshape(-1, 3), axis=1)
    there = np.isfinite(norms)  # the arrays are padded with NaN
    expert = info.configuration.get("expert", {})
    free = expert.get("free_force") if isinstance(expert, dict) else None
    if free is not None and not isinstance(free, int | float):
        raise EpisodeReadError(f"{path} says an expert's free force of {shown(free)}, not a number: record it anew")
    return EpisodeForces(
        phantom=info.phantom,
        target=info.target,
        operator=info.operator,
        free_force_n=None if free is None else float(free),
        magnitudes=np.linalg.norm(arrays["resultant_force"][steps], axis=1),
        points=points[there],
        forces=norms[there],
    )


def pooled(episodes: Sequence[EpisodeForces], phantom: str | None = None) -> Array:
    """Forces of every step of several episodes, one after the other.

    Args:
        episodes: which.
        phantom: only episodes in it.

    Returns:
        (n,) N.
    """
    chosen = [episode.magnitudes for episode in episodes if phantom in (None, episode.phantom)]
    return np.concatenate(chosen) if chosen else np.zeros(0)


def compare(simulated: Array, *, real_mean_n: float, real_sd_n: float, generator: np.random.Generator) -> Comparison:
    """Tests simulated forces against a normal distribution of real ones.

    As many forces as there are simulated ones are drawn from the normal distribution, negative ones included, as the
    thesis does it. Successive steps of an episode resemble each other, so the p-values overstate what they prove.

    Args:
        simulated: (n,) N.
        real_mean_n: mean of the real forces, N.
        real_sd_n: their standard deviation, N.
        generator: draws the real sample.

    Returns:
        The comparison.

    Raises:
        ValueError: there are too few forces to test, or some are not finite.
    """
    from scipy import stats

    simulated = np.asarray(simulated, dtype=np.float64)
    if simulated.ndim != 1 or len(simulated) < _TESTABLE or not np.isfinite(simulated).all():
        raise ValueError(f"expected at least {_TESTABLE} finite forces to compare, got shape {simulated.shape}")
    real = generator.normal(real_mean_n, real_sd_n, len(simulated))
    test = stats.mannwhitneyu(simulated, real, alternative="two-sided")
    # equal distances through the sorted sample keep its distribution
    kept = np.sort(simulated)[
        np.linspace(0, len(simulated) - 1, min(len(simulated), _SHAPIRO_LIMIT)).round().astype(int)
    ]
    constant = np.ptp(simulated) == 0.0  # Shapiro-Wilk is not defined; certainly not normal
    return Comparison(
        n=len(simulated),
        mean_n=float(simulated.mean()),
        sd_n=float(simulated.std()),
        median_n=float(np.median(simulated)),
        p95_n=float(np.percentile(simulated, 95)),
        max_n=float(simulated.max()),
        real_mean_n=real_mean_n,
        real_sd_n=real_sd_n,
        contact_share=float(np.mean(simulated > 0)),
        safe_share=float(np.mean(simulated < SAFE_FORCE_N)),
        u_statistic=float(test.statistic),
        mann_whitney_p=float(test.pvalue),
        exceedance=float(test.statistic) / len(simulated) ** 2,
        shapiro_p=0.0 if constant else float(stats.shapiro(kept).pvalue),
        levene_p=float(stats.levene(simulated, real).pvalue),
    )


def verdict(comparison: Comparison, episodes: Sequence[EpisodeForces], pushed: Array) -> tuple[str, str]:
    """Says what agrees with the real forces and what does not.

    Args:
        comparison: the tests.
        episodes: that the forces come from.
        pushed: (n,) N, forces of the same wire pushed without a planner.

    Returns:
        What agrees, and what differs; each one or several sentences.
    """
    c, agrees, differs = comparison, [], []
    real = f"N({c.real_mean_n:.2f}, {c.real_sd_n:.2f}) N"
    if c.mann_whitney_p >= SIGNIFICANCE:
        agrees.append(f"Mann-Whitney finds no difference in location from {real} (p = {c.mann_whitney_p:.2g}).")
    else:
        differs.append(_location(c))
    spread = f"the standard deviation is {c.sd_n:.3f} N, the real one {c.real_sd_n:.2f} N (Levene p = {c.levene_p:.2g})"
    (agrees if c.levene_p >= SIGNIFICANCE else differs).append(f"Spread: {spread}.")
    if c.shapiro_p >= SIGNIFICANCE:
        agrees.append(f"Shape: the forces may be normal (Shapiro-Wilk p = {c.shapiro_p:.2g}).")
    else:
        differs.append(
            f"Shape: the simulated forces are not normal (Shapiro-Wilk p = {c.shapiro_p:.2g}): none is negative, and "
            f"{100 * (1 - c.contact_share):.0f} % of the steps have no contact force at all, while the largest is "
            f"{c.max_n:.2f} N."
        )
    highest = c.real_mean_n + 3 * c.real_sd_n
    safe = f"{100 * c.safe_share:.4g} % of the simulated forces lie below {SAFE_FORCE_N:g} N"
    real_side = f"the real ones' mean + 3 SD is {highest:.2f} N"
    (agrees if c.safe_share > 0.99 and highest < SAFE_FORCE_N else differs).append(f"Safety: {safe}; {real_side}.")
    if differs:
        differs.append(_unlike(episodes, c, pushed))
    return " ".join(agrees) or "Nothing.", " ".join(differs) or "Nothing."


def _location(c: Comparison) -> str:
    """The difference of the means, and how often one force exceeds the other."""
    if c.max_n == 0:
        return f"Location: the simulated wire never presses on the wall, the real mean is {c.real_mean_n:.2f} N."
    low, high = sorted((c.mean_n, c.real_mean_n))
    side = "below" if c.mean_n < c.real_mean_n else "above"
    return (
        f"Location: the simulated mean, {c.mean_n:.3f} N, lies {side} the real {c.real_mean_n:.2f} N by a factor of "
        f"{high / low:.1f} (Mann-Whitney p = {c.mann_whitney_p:.2g}); a simulated force exceeds a real one in "
        f"{100 * c.exceedance:.0f} % of pairs, where 50 % would be alike."
    )


def _unlike(episodes: Sequence[EpisodeForces], c: Comparison, pushed: Array) -> str:
    """How the two were measured differently, as far as logs and thesis tell, and what of it could be tested."""
    free = sorted({episode.free_force_n for episode in episodes if episode.free_force_n is not None})
    operators = ", ".join(sorted({episode.operator.replace("_", " ") for episode in episodes}))
    times = float(pushed.mean()) / c.mean_n if c.mean_n > 0 else 0.0
    factor = f", {times:.1f} times as much: so much the steering can explain" if times > 0 else ""
    planner = f", which pays for forces above {free[0]:g} N and so avoids them" if free else ""
    return (
        "Mind what is compared: the real forces are those of a catheter on a silicone phantom, read from a load cell; "
        f"these are the contacts of a bare guidewire with a rigid wall, steered by the {operators}{planner}. Pushed at "
        f"full speed with random rotation instead, the wire gives {pushed.mean():.3f} ± {pushed.std():.3f} N{factor}. "
        "What the catheter, the elastic wall and the load cell contribute was not tested."
    )


def table_rows(comparison: Comparison, pushed: Array, agrees: str, differs: str) -> dict[str, dict[str, Any]]:
    """The rows of the report's table `force_validation`.

    Args:
        comparison: the tests.
        pushed: (n,) N, forces of the same wire pushed without a planner.
        agrees: what agrees, in words.
        differs: what does not.

    Returns:
        Row to column to cell.
    """
    c = comparison
    cells: dict[str, Any] = {
        "u_statistic": round(c.u_statistic, 1),
        "p_value": c.mann_whitney_p,
        "shapiro_p": c.shapiro_p,
        "levene_p": c.levene_p,
        "simulated_force_n": [c.mean_n, c.sd_n],
        "real_force_n": [c.real_mean_n, c.real_sd_n],
        "samples": c.n,
        "exceedance_pct": 100 * c.exceedance,
        "simulated_median_n": c.median_n,
        "simulated_p95_n": c.p95_n,
        "simulated_max_n": c.max_n,
        "contact_pct": 100 * c.contact_share,
        "pushed_force_n": [float(pushed.mean()), float(pushed.std())],
        "agrees": agrees,
        "differs": differs,
    }
    rows = {row: {"value": cell} for row, cell in cells.items()}
    rows["simulated_force_n"]["n"] = c.n
    rows["pushed_force_n"]["n"] = len(pushed)
    return rows
