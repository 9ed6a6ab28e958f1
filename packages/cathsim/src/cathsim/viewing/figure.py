"""Figures of matplotlib that need no screen, and one sentence where matplotlib is not installed."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def new_figure(**options: Any) -> Figure:
    """Makes an empty figure; options are those of matplotlib's `Figure`.

    Raises:
        ModuleNotFoundError: matplotlib is not installed; the message has the command that installs it.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "pictures are drawn with matplotlib: pip install 'endonav-cathsim[pictures]'", name=error.name
        ) from None
    figure = Figure(**options)
    FigureCanvasAgg(figure)
    return figure


def plain_text(text: str) -> str:
    """A text with names from outside as matplotlib draws it: no formula, and a mark where bytes are no letters."""
    return os.fsencode(text).decode("utf-8", "replace").replace("$", r"\$")
