"""Plots of what is learnt from expert episodes: success against episodes, and predicted against true forces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.report.plots.canvas import new_figure, save_figure

_SIZE = (6.4, 4.2)  # inches


def draw_success(
    curves: Mapping[str, Sequence[tuple[int, float, int]]],
    beside: Mapping[str, Sequence[tuple[str, float]]],
    file: Path,
) -> None:
    """Draws success against number of expert episodes.

    Args:
        curves: task to (episodes, success in %, evaluation episodes).
        beside: task to (row, success in %) of other ways to imitate.
        file: of the picture.
    """
    from cathsim.metrics.intervals import wilson_interval

    figure = new_figure(*_SIZE)
    axes = figure.subplots()
    for index, (task, points) in enumerate(curves.items()):
        ordered = sorted(points)
        counts, shares = [p[0] for p in ordered], [p[1] for p in ordered]
        bounds = [wilson_interval(round(share / 100 * n), n) for _, share, n in ordered]
        errors = np.array(
            [[s - 100 * low for s, (low, _) in zip(shares, bounds, strict=True)],
             [100 * high - s for s, (_, high) in zip(shares, bounds, strict=True)]]
        )  # fmt: skip
        colour = f"C{index}"
        axes.errorbar(counts, shares, yerr=np.clip(errors, 0, None), marker="o", capsize=3, color=colour, label=task)
        for place, (row, share) in enumerate(beside.get(task, ())):
            axes.plot(counts[-1] * (1.25 + 0.15 * place), share, marker="sD^v"[place % 4], color=colour, linestyle="")
            if index == 0:
                axes.plot([], [], marker="sD^v"[place % 4], color="0.4", linestyle="", label=row)
    axes.set(xlabel="expert episodes", ylabel="success, %", ylim=(-3, 103))
    axes.set_xscale("log")
    axes.legend(frameon=False, fontsize=8)
    axes.grid(alpha=0.3)
    save_figure(figure, file)


def draw_calibration(bins: Mapping[str, Mapping[str, Any]], file: Path) -> None:
    """Draws predicted against true contact force.

    Args:
        bins: name of a predictor to `predicted`, `true` and `true_sd`, N, an entry a bin.
        file: of the picture.
    """
    figure = new_figure(*_SIZE)
    axes = figure.subplots()
    top = 0.0
    for index, (name, values) in enumerate(bins.items()):
        predicted, true, spread = (np.asarray(values[key]) for key in ("predicted", "true", "true_sd"))
        axes.errorbar(predicted, true, yerr=spread, marker="o", capsize=3, label=name, color=f"C{index}", alpha=0.8)
        top = max(top, float(predicted.max()), float(true.max()))
    axes.plot([0, top], [0, top], color="0.5", linestyle="--", linewidth=1, label="perfect")
    axes.set(xlabel="predicted force, N (mean of a bin)", ylabel="true force, N (mean and sd of the bin)")
    axes.legend(frameon=False, fontsize=8)
    axes.grid(alpha=0.3)
    save_figure(figure, file)


def draw_shares(rows: Mapping[int, float], file: Path) -> None:
    """Draws the error of force prediction against number of samples.

    Args:
        rows: samples to mean squared error as a share of the variance, %.
        file: of the picture.
    """
    figure = new_figure(*_SIZE)
    axes = figure.subplots()
    counts = sorted(rows)
    axes.plot(counts, [rows[count] for count in counts], marker="o")
    axes.axhline(10.0, color="0.5", linestyle="--", linewidth=1)
    axes.set(xlabel="samples", ylabel="mean squared error / variance, %", ylim=(0, None))
    axes.set_xscale("log")
    axes.grid(alpha=0.3)
    save_figure(figure, file)
