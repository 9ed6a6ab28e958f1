"""Simulated contact forces against a normal distribution of real ones: tests, a verdict in words, heat on the wall."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cathsim.metrics.episodes import FORCE_LIMIT

SIGNIFICANCE = 0.05
HEAT_WIDTH = 2.0e-3  # m: a contact's heat falls off as a Gaussian of this width on the wall
_SHAPIRO_LIMIT = 5000  # samples beyond which scipy no longer vouches for the p-value
_TESTABLE = 8  # samples, below which the tests say nothing

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ForceComparison:
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


def compare_forces(
    simulated: Array, *, real_mean_n: float, real_sd_n: float, generator: np.random.Generator
) -> ForceComparison:
    """Tests simulated forces against a normal distribution of real ones.

    As many forces as there are simulated ones are drawn from the normal distribution, negative ones included, as the
    thesis does it. Successive steps of an episode resemble each other, so the p-values overstate what they prove.

    Args:
        simulated: (n,) N.
        real_mean_n: mean of the real forces, N.
        real_sd_n: their standard deviation, N.

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
    places = np.linspace(0, len(simulated) - 1, min(len(simulated), _SHAPIRO_LIMIT)).round().astype(int)
    constant = np.ptp(simulated) == 0.0  # Shapiro-Wilk is not defined; certainly not normal
    return ForceComparison(
        n=len(simulated),
        mean_n=float(simulated.mean()),
        sd_n=float(simulated.std()),
        median_n=float(np.median(simulated)),
        p95_n=float(np.percentile(simulated, 95)),
        max_n=float(simulated.max()),
        real_mean_n=real_mean_n,
        real_sd_n=real_sd_n,
        contact_share=float(np.mean(simulated > 0)),
        safe_share=float(np.mean(simulated < FORCE_LIMIT)),
        u_statistic=float(test.statistic),
        mann_whitney_p=float(test.pvalue),
        exceedance=float(test.statistic) / len(simulated) ** 2,
        shapiro_p=0.0 if constant else float(stats.shapiro(np.sort(simulated)[places]).pvalue),
        levene_p=float(stats.levene(simulated, real).pvalue),
    )


def verdict(
    c: ForceComparison,
    pushed: Array,
    read: Array | None = None,
    *,
    operators: Collection[str],
    free_force_n: float | None,
    catheters: Collection[str] = (),
    catheters_alone: Collection[str] = (),
    bare_wire: bool = True,
) -> tuple[str, str]:
    """Says what agrees with the real forces and what does not.

    Args:
        pushed: (n,) N, forces of the same wire pushed without a planner.
        read: (n,) N, what a load cell under the phantom reads of the same steps; None where it is not known.
        free_force_n: force that the operator does not pay for, N; None where it is not known.
        catheters: names of those that lay over a wire in some of the episodes.
        catheters_alone: names of those that had no wire in them.
        bare_wire: whether a wire without a catheter was steered in some of the episodes.

    Returns:
        What agrees, and what differs; each one or several sentences.
    """
    agrees, differs = [], []
    if c.mann_whitney_p >= SIGNIFICANCE:
        real = f"N({c.real_mean_n:.2f}, {c.real_sd_n:.2f}) N"
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
    safe = f"{100 * c.safe_share:.4g} % of the simulated forces lie below {FORCE_LIMIT:g} N"
    real_side = f"the real ones' mean + 3 SD is {highest:.2f} N"
    (agrees if c.safe_share > 0.99 and highest < FORCE_LIMIT else differs).append(f"Safety: {safe}; {real_side}.")
    if differs:
        device, bare_alone = _devices(catheters, catheters_alone, bare_wire=bare_wire)
        differs.append(_unlike(c, pushed, read, operators, free_force_n, device, bare_alone=bare_alone))
    return " ".join(agrees) or "Nothing.", " ".join(differs) or "Nothing."


def _location(c: ForceComparison) -> str:
    """Words the difference of the means, and how often one force exceeds the other."""
    if c.max_n == 0:
        return f"Location: the simulated device never presses on the wall, the real mean is {c.real_mean_n:.2f} N."
    low, high = sorted((c.mean_n, c.real_mean_n))
    side = "below" if c.mean_n < c.real_mean_n else "above"
    return (
        f"Location: the simulated mean, {c.mean_n:.3f} N, lies {side} the real {c.real_mean_n:.2f} N by a factor of "
        f"{high / low:.1f} (Mann-Whitney p = {c.mann_whitney_p:.2g}); a simulated force exceeds a real one in "
        f"{100 * c.exceedance:.0f} % of pairs, where 50 % would be alike."
    )


def _devices(catheters: Collection[str], catheters_alone: Collection[str], *, bare_wire: bool) -> tuple[str, bool]:
    """Words which devices were steered, and says whether it was the wire alone in all episodes."""
    steered = ["a bare guidewire"] if bare_wire else []
    if catheters:
        steered.append(f"a guidewire in a catheter ({', '.join(sorted(catheters))})")
    if catheters_alone:
        steered.append(f"a catheter without a wire ({', '.join(sorted(catheters_alone))})")
    if len(steered) > 1:
        steered[0] += " in some episodes"
    return ", in others of ".join(steered), not (catheters or catheters_alone)


def _unlike(
    c: ForceComparison,
    pushed: Array,
    read: Array | None,
    operators: Collection[str],
    free_force_n: float | None,
    device: str,
    *,
    bare_alone: bool,
) -> str:
    """Words how the two were measured differently, and which part of it was tested.

    Args:
        device: what was steered, in words.
        bare_alone: whether that was the bare wire in all episodes: what is pushed is comparable with no other device.
    """
    names = ", ".join(sorted(operator.replace("_", " ") for operator in operators))
    times = float(pushed.mean()) / c.mean_n if c.mean_n > 0 else 0.0
    factor = f", {times:.1f} times as much: so much the steering can explain" if times > 0 else ""
    without_planner = f"{pushed.mean():.3f} ± {pushed.std():.3f} N"
    unsteered = (
        f"Pushed at full speed with random rotation instead, the wire alone gives {without_planner}{factor}."
        if bare_alone
        else f"A bare wire that is pushed at full speed with random rotation gives {without_planner}: that is another "
        "device, so it does not tell what the steering contributes."
    )
    planner = "" if free_force_n is None else f", which pays for forces above {free_force_n:g} N and so avoids them"
    cell = (
        "What the load cell contributes is not known from these episodes."
        if read is None
        else f"Read as a load cell reads it (mean of each step, filtered, with noise), the same steps give "
        f"{read.mean():.3f} ± {read.std():.3f} N: the cell explains none of the difference."
        if read.mean() < 1.5 * c.mean_n or read.mean() < 0.25 * c.real_mean_n
        else f"Read as a load cell reads it (mean of each step, filtered, with noise), the same steps give "
        f"{read.mean():.3f} ± {read.std():.3f} N."
    )
    untested = "What the catheter contributes was not tested here; " if bare_alone else ""
    return (
        "Mind what is compared: the real forces are those of a catheter on a silicone phantom, read from a load cell; "
        f"these are the contacts of {device} with a rigid wall, steered by the {names}{planner}. {unsteered} "
        f"{cell} {untested}docs/results/forces.md compares devices, and shows that the wall's stiffness changes the "
        "resultant by a few per cent."
    )


def wall_heat(vertices: Array, points: Array, forces: Array) -> tuple[Array, Array]:
    """Spreads contact forces over the vessel wall.

    Args:
        vertices: (v, 3) m, of the wall.
        points: (k, 3) m, contacts.
        forces: (k,) N, their magnitudes.

    Returns:
        Each vertex's largest and summed force, (v,) N each; a contact counts fully where it lies and as a Gaussian of
        its distance around.
    """
    from scipy.spatial import cKDTree

    largest, total = np.zeros(len(vertices)), np.zeros(len(vertices))
    if len(points):
        neighbours = cKDTree(vertices).query_ball_point(points, 3 * HEAT_WIDTH)
        for near, point, force in zip(neighbours, points, forces, strict=True):
            square = ((vertices[near] - point) ** 2).sum(axis=1)
            heat = force * np.exp(-square / (2 * HEAT_WIDTH**2))
            largest[near] = np.maximum(largest[near], heat)
            total[near] += heat
    return largest, total
