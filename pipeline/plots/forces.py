"""Plots of contact forces: their distribution beside the real one, heat maps on the vessel wall."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pipeline.evaluations.forces import EpisodeForces
from pipeline.plots.canvas import MM, new_figure, save_figure, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PIXEL = 1.0e-3  # m
_REAL = "tab:orange"
_FORCE = "resultant contact force of a step (N)"

Array = NDArray[np.float64]


def draw_distribution(simulated: Array, real_mean_n: float, real_sd_n: float, file: Path) -> None:
    """Draws the forces of all steps, (n,) N, beside the real normal distribution: density and cumulated."""
    from scipy.stats import norm

    figure = new_figure(9.0, 3.8)
    density, cumulated = figure.subplots(1, 2)
    top = max(float(simulated.max()), real_mean_n + 3.5 * real_sd_n)
    low = min(0.0, real_mean_n - 3.5 * real_sd_n)
    at = np.linspace(low, top, 400)
    label = f"real, N({real_mean_n:.2f}, {real_sd_n:.2f}) N"
    density.hist(simulated, bins=np.linspace(0, top, 60), density=True, color="tab:blue", alpha=0.6, label="simulated")
    density.plot(at, norm.pdf(at, real_mean_n, real_sd_n), color=_REAL, label=label)
    density.set(xlabel=_FORCE, ylabel="density (1/N)", yscale="log")
    density.set_ylim(bottom=0.01)
    ordered = np.sort(simulated)
    cumulated.step(ordered, np.arange(1, len(ordered) + 1) / len(ordered), where="post", label="simulated")
    cumulated.plot(at, norm.cdf(at, real_mean_n, real_sd_n), color=_REAL, label=label)
    cumulated.set(xlabel=_FORCE, ylabel="share of the steps below", ylim=(0, 1.02))
    style(density)
    style(cumulated)
    save_figure(figure, file)


def draw_heat(vertices: Array, episodes: Sequence[EpisodeForces], file: Path, *, title: str) -> None:
    """Draws where the wire pressed on the wall, (v, 3) m, from the front; along a line of sight the hottest counts."""
    from cathsim.metrics.forces import wall_heat

    points = np.concatenate([episode.points for episode in episodes])
    forces = np.concatenate([episode.forces for episode in episodes])
    steps = max(sum(len(episode.magnitudes) for episode in episodes), 1)
    largest, total = wall_heat(vertices, points, forces)
    figure = new_figure(9.4, 5.2)
    left, right = figure.subplots(1, 2)
    _draw_projection(figure, left, vertices, largest, "largest contact force (N)")
    _draw_projection(figure, right, vertices, total / steps, "mean contact force over all steps (N)")
    figure.suptitle(title, fontsize=11)
    save_figure(figure, file)


def _draw_projection(figure: Figure, axes: Axes, vertices: Array, heat: Array, label: str) -> None:
    low = vertices.min(axis=0) - 3 * PIXEL
    column, row = (np.round((vertices[:, k] - low[k]) / PIXEL).astype(int) for k in (0, 2))
    shape = (row.max() + 4, column.max() + 4)
    image, covered = np.zeros(shape), np.zeros(shape, bool)
    np.maximum.at(image, (row, column), heat)
    covered[row, column] = True
    # a surface seen edge on leaves pixels without a vertex
    from scipy.ndimage import binary_closing, grey_closing

    covered, image = binary_closing(covered, iterations=2), grey_closing(image, size=(3, 3))
    extent = tuple(MM * (low[k] + PIXEL * (edge - 0.5)) for k, edge in ((0, 0), (0, shape[1]), (2, 0), (2, shape[0])))
    place: dict[str, Any] = {"extent": extent, "origin": "lower"}
    hottest = float(image.max()) or 1.0
    mappable = axes.imshow(np.where(covered, image, np.nan), cmap="YlOrRd", vmin=0.0, vmax=hottest, **place)
    axes.contour(covered, levels=[0.5], colors="0.35", linewidths=0.8, **place)
    axes.set(xlabel="x, patient's left (mm)", ylabel="z, superior (mm)", aspect="equal")
    figure.colorbar(mappable, ax=axes, label=label, shrink=0.75)
