"""Plots of learning: training curves over seeds, episode length, forces by row, paths."""

from __future__ import annotations

import csv
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pipeline.evaluations.logs import changed_settings, stage_of
from pipeline.plots.canvas import MM, new_figure, save_figure, style
from pipeline.plots.episodes import draw_vessel

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from cathsim import Phantom


FILE = "training.csv"
_POINTS = 200  # of a joint curve

Array = NDArray[np.float64]

_LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True)
class Curve:
    """How one training went."""

    stage: str  # whose training it was
    phantom: str
    target: str
    row: str  # what was trained, with whatever else a sweep changed in brackets
    seed: str  # of the training, as its folder names it
    columns: dict[str, Array]  # name to (n,) values, NaN where a row of the file has none

    def pairs(self, x: str, y: str) -> tuple[Array, Array]:
        """The (m,) values of two columns where both have one, x rising; empty where a column is missing."""
        nothing = np.zeros(0)
        at, values = (self.columns.get(name, nothing) for name in (x, y))
        if not len(at) or not len(values):
            return nothing, nothing
        finite = np.isfinite(at) & np.isfinite(values)
        order = np.argsort(at[finite], kind="stable")
        return at[finite][order], values[finite][order]


@dataclass(frozen=True)
class Band:
    """Mean and spread of a curve over seeds."""

    x: Array  # (m,) common positions
    mean: Array  # (m,)
    spread: Array  # (m,) standard deviation over the seeds, n - 1 in the denominator; nought with one seed
    seeds: int


def read_curves(folders: Sequence[Path]) -> list[Curve]:
    """Reads the training curves of stage folders, `<phantom>/<target>/<row>/seed<k>/training.csv`."""
    curves = []
    for folder in folders:
        changed = changed_settings(folder.name)
        for path in sorted(folder.glob(f"*/*/*/seed*/{FILE}")):
            phantom, target, row, seed = path.relative_to(folder).parts[:4]
            columns = read_columns(path)
            if columns:
                name = f"{row} ({changed})" if changed else row
                curves.append(Curve(stage_of(folder.name), phantom, target, name, seed, columns))
            else:
                _LOGGER.warning("left out: %s holds no row of numbers", path)
    return curves


def read_columns(path: Path) -> dict[str, Array]:
    """Reads a CSV file with a head line: column to (n,) values, NaN where a cell is empty; cut lines are skipped."""
    rows = []
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            reader = csv.reader(stream)
            head = next(reader, [])
            for cells in reader:
                if len(cells) != len(head):
                    continue
                try:
                    rows.append([float(cell) if cell.strip() else np.nan for cell in cells])
                except ValueError:
                    continue
    except (OSError, UnicodeDecodeError, csv.Error):
        return {}
    values = np.array(rows, dtype=np.float64).reshape(len(rows), len(head))
    return {name: values[:, index] for index, name in enumerate(head)} if rows else {}


def join_seeds(curves: Sequence[Curve], x: str, y: str) -> Band | None:
    """Mean and spread of y over x, as far as every seed went; None where they share no stretch of two points."""
    points = [pair for pair in (curve.pairs(x, y) for curve in curves) if len(pair[0]) > 1]
    if not points:
        return None
    first, last = max(at[0] for at, _ in points), min(at[-1] for at, _ in points)
    if last <= first:
        return None
    common = np.linspace(first, last, _POINTS)
    values = np.stack([np.interp(common, at, of_seed) for at, of_seed in points])
    spread = values.std(axis=0, ddof=1) if len(points) > 1 else np.zeros(len(common))
    return Band(common, values.mean(axis=0), spread, len(points))


_HUMAN = "tab:orange"
_PATHS = {"ENN": "tab:blue", "Sampling expert": "tab:green", "Human": _HUMAN}

Grouped = Mapping[str, Mapping[str, Sequence[Curve]]]  # task -> row -> a curve a seed


@dataclass(frozen=True)
class Panel:
    """A column of the training figure: what is drawn over what."""

    x: str
    y: str
    x_label: str
    y_label: str
    x_scale: float = 1.0
    y_scale: float = 1.0


TRAINING_PANELS = (
    Panel("env_steps", "reward", "environment steps", "mean reward of the last 100 steps"),
    Panel("decisions", "evaluation_success", "decisions", "success in evaluation (%)", y_scale=100.0),
    Panel("cpu_s", "evaluation_success", "CPU minutes", "success in evaluation (%)", 1 / 60, 100.0),
)


def draw_training(tasks: Grouped, labels: Mapping[str, str], file: Path) -> None:
    """Draws reward and evaluated success of every task; thin lines are seeds, thick ones means with their spread."""
    figure = new_figure(12.0, 0.7 + 2.7 * len(tasks))
    grid = figure.subplots(len(tasks), len(TRAINING_PANELS), squeeze=False)
    colours = _colours(tasks)
    for line, (task, of_task) in zip(grid, tasks.items(), strict=True):
        for axes, panel in zip(line, TRAINING_PANELS, strict=True):
            for row, curves in of_task.items():
                _draw_curves(axes, curves, panel, color=colours[row], label=labels.get(row, row))
            if panel.y == "evaluation_success":
                axes.set_ylim(-4, 104)
            axes.set(xlabel=panel.x_label, ylabel=panel.y_label)
            axes.locator_params(axis="x", nbins=5)
            axes.grid(alpha=0.3)
        line[0].set_title(task, loc="left", fontsize=10)
    handles = {
        text: handle for axes in grid.flat for handle, text in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    if handles:
        figure.legend(
            handles.values(), handles.keys(), loc="outside upper center", ncols=min(len(handles), 7), frameon=False,
            fontsize=9,
        )  # fmt: skip
    save_figure(figure, file)


def _colours(tasks: Grouped) -> dict[str, str]:
    rows = dict.fromkeys(row for of_task in tasks.values() for row in of_task)
    return {row: f"C{index % 10}" for index, row in enumerate(rows)}


def _draw_curves(axes: Axes, curves: Sequence[Curve], panel: Panel, *, color: str, label: str) -> None:
    points = [curve.pairs(panel.x, panel.y) for curve in curves]
    band = join_seeds(curves, panel.x, panel.y)
    if len(curves) > 1:
        for at, values in points:
            axes.plot(panel.x_scale * at, panel.y_scale * values, color=color, linewidth=0.6, alpha=0.45)
    if band is None:  # a single point, or nothing in common
        for at, values in points:
            axes.plot(panel.x_scale * at, panel.y_scale * values, ".", color=color, label=label if len(at) else None)
        return
    x, mean, spread = panel.x_scale * band.x, panel.y_scale * band.mean, panel.y_scale * band.spread
    axes.plot(x, mean, color=color, linewidth=1.7, label=label)
    if band.seeds > 1:
        axes.fill_between(x, mean - spread, mean + spread, color=color, alpha=0.15, linewidth=0)


def draw_lengths(tasks: Grouped, human: Mapping[str, Array], labels: Mapping[str, str], file: Path) -> None:
    """Draws the evaluated episode length by checkpoint of each task, and the (n,) steps of people's episodes."""
    panel = Panel("decisions", "evaluation_length", "decisions", "episode length (steps)")
    figure = new_figure(max(5.0, 3.9 * len(tasks)), 3.6)
    panels = figure.subplots(1, len(tasks), squeeze=False, sharey=True)[0]
    colours = _colours(tasks)
    for axes, (task, of_task) in zip(panels, tasks.items(), strict=True):
        if len(human.get(task, ())):
            lengths = human[task]
            mean, spread = float(np.mean(lengths)), float(np.std(lengths))
            axes.axhline(mean, color=_HUMAN, linestyle="--", linewidth=1.4, label=f"human, {len(lengths)} episodes")
            axes.axhspan(mean - spread, mean + spread, color=_HUMAN, alpha=0.12, linewidth=0)
        for row, curves in of_task.items():
            _draw_curves(axes, curves, panel, color=colours[row], label=labels.get(row, row))
        axes.set(xlabel=panel.x_label, ylabel=panel.y_label if axes is panels[0] else "", title=task)
        axes.title.set_fontsize(10)
        axes.locator_params(axis="x", nbins=5)
        axes.set_ylim(bottom=0.0)
        style(axes)
    save_figure(figure, file)


def draw_largest_forces(phantoms: Mapping[str, Mapping[tuple[str, str], Array]], file: Path) -> None:
    """Draws box plots of largest forces, (n,) N an episode by row and target, a panel a phantom, as the thesis does."""
    figure = new_figure(max(6.0, 6.2 * len(phantoms)), 4.4)
    panels = figure.subplots(1, len(phantoms), squeeze=False, sharey=True)[0]
    for axes, (phantom, boxes) in zip(panels, phantoms.items(), strict=True):
        rows = list(dict.fromkeys(row for row, _ in boxes))
        targets = sorted({target for _, target in boxes})
        width = 0.8 / len(targets)
        for index, target in enumerate(targets):
            row_boxes = [(place, boxes[row, target]) for place, row in enumerate(rows) if (row, target) in boxes]
            drawn = axes.boxplot(
                [values for _, values in row_boxes],
                positions=[place + (index - (len(targets) - 1) / 2) * width for place, _ in row_boxes],
                widths=0.85 * width, whis=(5, 95), patch_artist=True, manage_ticks=False,
                medianprops={"color": "black"}, flierprops={"markersize": 2, "alpha": 0.5},
                boxprops={"facecolor": f"C{index}", "alpha": 0.55},
            )  # fmt: skip
            drawn["boxes"][0].set_label(target.upper())
        axes.set_xticks(range(len(rows)), rows, rotation=35, ha="right", fontsize=8)
        axes.set(title=phantom, ylabel="largest contact force of an episode (N)")
        axes.title.set_fontsize(10)
        axes.set_ylim(bottom=0.0)
        style(axes, grid="y")
    save_figure(figure, file)


def draw_paths(
    phantom: Phantom, target: str, paths: Mapping[str, Sequence[tuple[Array, bool]]], file: Path, *, radius_mm: float
) -> None:
    """Draws the tip's paths, (T + 1, 3) m and whether it succeeded, in the vessel, a panel for each who steered."""
    nonempty_paths = {who: of_one for who, of_one in paths.items() if of_one}
    figure = new_figure(3.6 * len(nonempty_paths), 4.6)
    panels = figure.subplots(1, len(nonempty_paths), squeeze=False, sharey=True)[0]
    for axes, (who, of_one) in zip(panels, nonempty_paths.items(), strict=True):
        draw_vessel(axes, phantom, target, radius_mm=radius_mm)
        for path, success in of_one:
            x, z = path[:, 0] * MM, path[:, 2] * MM
            axes.plot(x, z, linewidth=1.0, alpha=0.7, color=_PATHS[who])
            axes.plot(x[-1], z[-1], "o" if success else "x", markersize=4, color=_PATHS[who] if success else "black")
        axes.set_title(f"{who}, {len(of_one)} episode{'' if len(of_one) == 1 else 's'}", fontsize=10)
        if axes is not panels[0]:
            axes.set_ylabel("")
    save_figure(figure, file)
