"""The figure of the forces: three quantities by device, operator and friction, beside the measured distribution."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.forces.episodes import Episode

REAL_MEAN, REAL_SD = 0.40, 0.19  # N, a catheter steered through a robot in a silicone phantom of Type I
QUANTITIES = {"load_cell": "load cell", "sum": "sum of magnitudes", "largest": "largest contact"}


def draw(episodes: Sequence[Episode], file: Path) -> None:
    """Draws the three quantities by device, operator and friction beside the measured distribution."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    rows = list(dict.fromkeys((one.case.device, one.case.operator) for one in episodes))
    frictions = sorted({one.case.friction for one in episodes})
    colours = [
        (0.75 - 0.6 * share, 0.85 - 0.5 * share, 0.95 - 0.3 * share) for share in np.linspace(0, 1, len(frictions))
    ]
    figure = Figure(figsize=(11.0, 1.6 + 0.7 * len(rows)), layout="constrained")
    for axes, (name, label) in zip(figure.subplots(1, 3, sharey=True), QUANTITIES.items(), strict=True):
        axes.axvspan(REAL_MEAN - REAL_SD, REAL_MEAN + REAL_SD, color="tab:orange", alpha=0.2)
        axes.axvline(REAL_MEAN, color="tab:orange")
        for place, (device, operator) in enumerate(rows):
            for index, friction in enumerate(frictions):
                wanted = device, operator, friction
                chosen = [
                    one.quantities()[name]
                    for one in episodes
                    if (one.case.device, one.case.operator, one.case.friction) == wanted
                ]
                if not chosen:
                    continue
                box = axes.boxplot(
                    [np.concatenate(chosen)],
                    positions=[place + 0.8 * ((index + 0.5) / len(frictions) - 0.5)],
                    widths=0.7 / len(frictions),
                    orientation="horizontal",
                    whis=(5, 95),
                    showfliers=False,
                    showmeans=True,
                    patch_artist=True,
                    medianprops={"color": "black"},
                    meanprops={"markersize": 4, "markerfacecolor": "black", "markeredgecolor": "black"},
                )
                box["boxes"][0].set(facecolor=colours[index], alpha=1.0)
        axes.set(xlabel=f"{label} (N)", xscale="log", xlim=(2e-3, 20.0))
        axes.set_yticks(range(len(rows)), [f"{device}\n{operator.replace('_', ' ')}" for device, operator in rows])
        axes.invert_yaxis() if axes.get_subplotspec().is_first_col() else None
        axes.grid(axis="x", alpha=0.3)
    handles = [
        Patch(color=colour, label=f"friction {friction:g}") for colour, friction in zip(colours, frictions, strict=True)
    ]
    handles.append(Patch(color="tab:orange", alpha=0.3, label=f"measured, {REAL_MEAN:.2f} ± {REAL_SD:.2f} N"))
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize=8)
    figure.suptitle(
        "Box: quartiles; whiskers: 5 and 95 %; triangle: mean; all steps, both targets; logarithmic", fontsize=9
    )
    figure.savefig(file, dpi=140)
