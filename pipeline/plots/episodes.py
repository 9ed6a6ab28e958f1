"""Plots of recorded episodes: the tip's path in the vessel, the contact force over time, the planned path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pipeline.plots.canvas import MM, new_figure, save_figure
from pipeline.store.atomic_files import atomic_path
from pipeline.words import in_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from cathsim import Phantom


def draw_task(
    phantom: Phantom, target: str, episodes: Sequence[Mapping[str, np.ndarray]], file: Path, *, radius_mm: float = 8.0
) -> None:
    """Draws the paths of the tip in the frontal view of a phantom, and the forces.

    Args:
        episodes: arrays of each log: tip (T + 1, 3) m, resultant_force (T + 1, 3) N.
        radius_mm: of the sphere of success.
    """
    figure = new_figure(9.0, 4.6)
    vessel, force = figure.subplots(1, 2, width_ratios=(1.0, 1.35))
    draw_vessel(vessel, phantom, target, radius_mm=radius_mm)
    for index, arrays in enumerate(episodes):
        tips = arrays["tip"] * MM
        vessel.plot(tips[:, 0], tips[:, 2], linewidth=1.2, color=f"C{index % 10}")
        norms = np.linalg.norm(arrays["resultant_force"], axis=1)
        force.plot(np.arange(len(norms)), norms, linewidth=1.0, color=f"C{index % 10}", label=f"episode {index}")
    vessel.set(title="path of the tip")
    force.set(xlabel="step (0.1 s)", ylabel="resultant contact force (N)", title="largest force of each step")
    force.set_ylim(bottom=0.0)
    force.grid(alpha=0.3)
    if len(episodes) <= 10:
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


def draw_planned_path(phantom: Phantom, target: str, file: Path, *, entry: str = "descending") -> float:
    """Plans the shortest path from an entry to a target with A*, draws it and returns its length, m."""
    from cathsim.planning.path import picture, plan_path

    path = plan_path(phantom.grid, phantom.entry(entry).position, phantom.target(target).position)
    with atomic_path(file) as temporary:
        picture(path, phantom.grid, temporary, title=in_words(f"{phantom.name}, {target.upper()}"))
    return path.length
