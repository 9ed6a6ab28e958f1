"""Plots of episodes: path and force, the planned path, predicted forces."""

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


_SIZE = (6.4, 4.2)  # inches


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
