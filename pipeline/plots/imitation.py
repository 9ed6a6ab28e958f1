"""Plots of learning from expert episodes: success against episodes, and predicted against true forces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.plots.canvas import chart

_SIZE = (6.4, 4.2)  # inches


def draw_success(
    curves: Mapping[str, Sequence[tuple[int, float, int]]],
    beside: Mapping[str, Sequence[tuple[str, float]]],
    file: Path,
) -> None:
    """Draws success against number of expert episodes, with Wilson's 95 % intervals.

    Args:
        curves: task to (expert episodes, success in %, evaluation episodes).
        beside: task to (row, success in %) of other ways to imitate.
    """
    from cathsim.metrics.intervals import wilson_interval

    with chart(file, *_SIZE) as axes:
        for index, (task, points) in enumerate(curves.items()):
            counts, shares, trials = (np.array(values) for values in zip(*sorted(points), strict=True))
            bounds = [wilson_interval(round(s / 100 * n), int(n)) for s, n in zip(shares, trials, strict=True)]
            low, high = 100 * np.array(bounds).T
            errors = np.clip([shares - low, high - shares], 0, None)
            colour = f"C{index}"
            axes.errorbar(counts, shares, yerr=errors, marker="o", capsize=3, color=colour, label=task)
            for place, (row, share) in enumerate(beside.get(task, ())):
                at, marker = counts[-1] * (1.25 + 0.15 * place), "sD^v"[place % 4]
                axes.plot(at, share, marker=marker, color=colour, linestyle="")
                if index == 0:
                    axes.plot([], [], marker=marker, color="0.4", linestyle="", label=row)
        axes.set(xlabel="expert episodes", ylabel="success, %", ylim=(-3, 103), xscale="log")


def draw_calibration(bins: Mapping[str, Mapping[str, Any]], file: Path) -> None:
    """Draws predicted against true contact force.

    Args:
        bins: name of a predictor to `predicted`, `true` and `true_sd`, N, an entry a bin.
    """
    with chart(file, *_SIZE) as axes:
        top = 0.0
        for index, (name, values) in enumerate(bins.items()):
            predicted, true, spread = (np.asarray(values[key]) for key in ("predicted", "true", "true_sd"))
            colour = f"C{index}"
            axes.errorbar(predicted, true, yerr=spread, marker="o", capsize=3, label=name, color=colour, alpha=0.8)
            top = max(top, float(predicted.max()), float(true.max()))
        axes.plot([0, top], [0, top], color="0.5", linestyle="--", linewidth=1, label="perfect")
        axes.set(xlabel="predicted force, N (mean of a bin)", ylabel="true force, N (mean and sd of the bin)")


def draw_shares(rows: Mapping[int, float], file: Path) -> None:
    """Draws the error of force prediction: samples to mean squared error as a share of the variance, %."""
    with chart(file, *_SIZE) as axes:
        counts = sorted(rows)
        axes.plot(counts, [rows[count] for count in counts], marker="o")
        axes.axhline(10.0, color="0.5", linestyle="--", linewidth=1)
        axes.set(xlabel="samples", ylabel="mean squared error / variance, %", ylim=(0, None), xscale="log")
