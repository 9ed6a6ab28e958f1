"""Confidence intervals of shares, such as the success of a number of episodes."""

from __future__ import annotations

import math

Z_95 = 1.959964  # two-sided 95 % of the normal distribution


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
