"""Plot of navigation: how trials ended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from pipeline.plots.canvas import new_figure, save_figure

_COLOURS = ("#3a7d44", "#c0504d", "#e69f00", "#8064a2", "#7f7f7f")  # success, then the modes


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
