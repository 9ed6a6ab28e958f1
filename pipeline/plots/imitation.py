"""Plots of learning from expert episodes: success against episodes, predicted against true forces, failed trials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.plots.canvas import chart, new_figure, save_figure

_COLOURS = ("#3a7d44", "#c0504d", "#e69f00", "#8064a2", "#7f7f7f")  # success, then the modes
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
    from cathsim.metrics.episodes import wilson_interval

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


def draw_failures(
    rows: Mapping[str, Mapping[str, int]], labels: Mapping[str, str], modes: Sequence[str], file: Path
) -> None:
    """Draws how trials ended, a bar each.

    Args:
        rows: name of a bar to "success" and each mode, numbers of trials.
        modes: of failure, in their order.
    """
    figure = new_figure(7.2, max(3.6, 0.32 * len(rows) + 1.2))
    axes = figure.subplots()
    names = list(rows)[::-1]
    totals = np.array([max(1, sum(rows[name].values())) for name in names], float)
    left = np.zeros(len(names))
    for kind, colour in zip(("success", *modes), _COLOURS, strict=True):
        shares = 100 * np.array([rows[name].get(kind, 0) for name in names]) / totals
        axes.barh(names, shares, left=left, color=colour, label=labels.get(kind, kind))
        left += shares
    axes.set(xlabel="trials, %", xlim=(0, 100))
    axes.tick_params(axis="y", labelsize=8)
    axes.legend(frameon=False, fontsize=8, ncols=5, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    save_figure(figure, file)
