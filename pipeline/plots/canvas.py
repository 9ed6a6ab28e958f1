"""The canvas of plots: figures that need no display, charts and wires in space, saved as a whole file or not at all."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.plots.words import in_words
from pipeline.store.atomic_files import atomic_path

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MM = 1e3  # a metre
_DOTS_PER_INCH = 220  # twice what a page of 96 dots an inch shows: sharp on screens with two dots a pixel
_ANGLES = ((20.0, -80.0), (20.0, 10.0))  # elevation and azimuth of the two views of wires in space, degrees
_LINES = (("0.4", 3.0), ("tab:red", 1.2), ("tab:cyan", 1.0))  # colour and width of the wires of one column


def new_figure(width: float, height: float) -> Figure:
    """Makes an empty figure, sizes in inches, whose parts make room for each other."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Figure, file: Path) -> None:
    """Writes a figure as PNG, keys in its texts in words; the file's folder is made."""
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        if isinstance(text, Text) and "_" in text.get_text() and "$" not in text.get_text():
            text.set_text(in_words(text.get_text()))
    with atomic_path(file) as temporary:
        figure.savefig(temporary, format="png", dpi=_DOTS_PER_INCH)


def style(axes: Axes, *, grid: Any = "both", **legend: Any) -> None:
    """Adds a faint grid ("both", "x", "y"), and a legend (arguments of `Axes.legend`) where something has a label."""
    axes.grid(alpha=0.3, axis=grid)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(**{"frameon": False, "fontsize": 8, **legend})


@contextmanager
def chart(file: Path, width: float = 6.8, height: float = 4.2, *, grid: Any = "both", **legend: Any) -> Iterator[Axes]:
    """Gives one pair of axes to draw on, then adds grid and legend and writes the PNG; sizes in inches."""
    figure = new_figure(width, height)
    axes = figure.subplots()
    yield axes
    style(axes, grid=grid, **legend)
    save_figure(figure, file)


def window(points: np.ndarray, shape: tuple[int, ...], margin_px: int) -> tuple[slice, slice]:
    """Rows and columns of a square about points, (n, 2) px, column and row, n >= 1, inside an image of a shape."""
    low, high = points.min(0) - margin_px, points.max(0) + margin_px
    side = min(int((high - low).max()), *shape)
    corner = np.clip((low + high - side) / 2, 0, np.array(shape[::-1]) - side).astype(int)
    return slice(corner[1], corner[1] + side), slice(corner[0], corner[0] + side)


def draw_in_space(wires: Sequence[tuple[str, Mapping[str, np.ndarray]]], file: Path) -> None:
    """Draws wires in space from two angles, a column each: title and, by name, (n, 3) mm; a dot marks the tip."""
    figure = new_figure(4.0 * len(wires), 7.6)
    for column, (title, curves) in enumerate(wires):
        every = np.concatenate(list(curves.values()))
        middle, reach = (every.max(axis=0) + every.min(axis=0)) / 2, np.ptp(every, axis=0).max() / 2
        for row, (elevation, azimuth) in enumerate(_ANGLES):
            axes: Any = figure.add_subplot(2, len(wires), row * len(wires) + column + 1, projection="3d")
            for (name, curve), (colour, width) in zip(curves.items(), cycle(_LINES), strict=False):
                axes.plot(*curve.T, label=name, alpha=0.8, color=colour, linewidth=width)
                axes.plot(*curve[:1].T, marker="o", markersize=3, color=colour)
            axes.view_init(elevation, azimuth)
            axes.set_box_aspect(None, zoom=0.88)  # room for the labels
            for axis, centre in zip("xyz", middle, strict=True):
                getattr(axes, f"set_{axis}lim")(centre - reach, centre + reach)
                getattr(axes, f"set_{axis}label")(f"{axis}, mm", fontsize=7)
            axes.tick_params(labelsize=6)
            if row == 0:
                axes.set_title(title, fontsize=8)
                axes.legend(fontsize=7, loc="upper left")
    save_figure(figure, file)
