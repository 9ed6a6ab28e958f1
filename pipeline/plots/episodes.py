"""Plots of episodes: path and force, the planned path, success by expert episodes, predicted forces, failures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.plots.canvas import MM, chart, new_figure, save_figure
from pipeline.plots.words import in_words
from pipeline.store.atomic_files import atomic_path

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from cathsim import Phantom


def draw_task(phantom: Phantom, target: str, logs: Sequence[Path], file: Path, *, radius_mm: float = 8.0) -> None:
    """Draws the paths of the tip in the frontal view of a phantom, and the forces, of logged episodes.

    Raises:
        EpisodeReadError: a log is damaged.
    """
    from pipeline.episodes import EpisodeReader

    figure = new_figure(9.0, 4.6)
    vessel, force = figure.subplots(1, 2, width_ratios=(1.0, 1.35))
    draw_vessel(vessel, phantom, target, radius_mm=radius_mm)
    for index, path in enumerate(logs):
        with EpisodeReader(path) as log:
            arrays = log.load_arrays(pictures=False)
        tips = arrays["tip"] * MM
        vessel.plot(tips[:, 0], tips[:, 2], linewidth=1.2, color=f"C{index % 10}")
        norms = np.linalg.norm(arrays["resultant_force"], axis=1)
        force.plot(np.arange(len(norms)), norms, linewidth=1.0, color=f"C{index % 10}", label=f"episode {index}")
    vessel.set(title="path of the tip")
    force.set(xlabel="step (0.1 s)", ylabel="resultant contact force (N)", title="largest force of each step")
    force.set_ylim(bottom=0.0)
    force.grid(alpha=0.3)
    if len(logs) <= 10:
        force.legend(frameon=False, fontsize=8)
    save_figure(figure, file)


def draw_vessel(axes: Axes, phantom: Phantom, target: str, *, radius_mm: float = 8.0) -> None:
    """Draws the frontal view of a phantom's lumen, mm, with a target and its sphere of success."""
    from matplotlib.patches import Circle

    grid = phantom.grid
    x, z = (grid.origin[axis] + grid.spacing * np.arange(grid.shape[axis]) for axis in (0, 2))
    silhouette = grid.silhouette(1).T
    axes.contourf(x * MM, z * MM, silhouette, levels=[0.0, 1.0], colors=["#f3d9d6"])
    axes.contour(x * MM, z * MM, silhouette, levels=[0.0], colors="0.45", linewidths=0.8)
    goal = phantom.target(target).position * MM
    axes.add_patch(Circle((goal[0], goal[2]), radius_mm, fill=False, linestyle="--", color="tab:green"))
    axes.plot(goal[0], goal[2], "*", color="tab:green", markersize=11)
    axes.set(aspect="equal", xlabel="x, patient's left (mm)", ylabel="z, superior (mm)")


def draw_planned_path(phantom: Phantom, target: str, file: Path, *, entry: str) -> float:
    """Plans the shortest path from an entry to a target with A*, draws it and returns its length, m."""
    from cathsim.planning.path import picture, plan_path

    path = plan_path(phantom.grid, phantom.entry(entry).position, phantom.target(target).position)
    with atomic_path(file) as temporary:
        picture(path, phantom.grid, temporary, title=in_words(f"{phantom.name}, {target.upper()}"))
    return path.length


_COLOURS = ("#3a7d44", "#c0504d", "#e69f00", "#8064a2", "#7f7f7f")  # success, then the modes
_SIZE = (6.4, 4.2)  # inches


def draw_success(
    curves: Mapping[str, Sequence[tuple[int, float, int]]],
    beside: Mapping[str, Sequence[tuple[str, float]]],
    file: Path,
) -> None:
    """Draws success by expert episodes, task to (episodes, %, trials), and other rows, (row, %), beside."""
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
    """Draws predicted against true contact force: predictor to `predicted`, `true` and `true_sd`, N, an entry a bin."""
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
    """Draws how trials ended, a bar each: its name to the numbers of "success" and of each mode of failure."""
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
