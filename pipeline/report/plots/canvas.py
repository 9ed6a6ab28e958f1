"""The canvas of plots: a figure that needs no display, saved as a whole file or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.store.atomic_files import atomic_path

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DOTS_PER_INCH = 110


def new_figure(width: float, height: float) -> Figure:
    """An empty figure whose parts make room for each other.

    Args:
        width: inches.
        height: inches.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Figure, file: Path) -> None:
    """Writes a figure as PNG.

    Args:
        figure: from `new_figure`.
        file: the PNG; its folder is made.
    """
    with atomic_path(file) as temporary:
        figure.savefig(temporary, format="png", dpi=_DOTS_PER_INCH)
