"""Picture of an imported anatomy: its vessels by name, their ends, and the doubts of the import where they belong."""

from __future__ import annotations

import logging
import re
import textwrap
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cathsim.anatomy.phantom import Phantom
from cathsim.anatomy.pictures.phantom_picture import VIEWS, camera, picture_point, render_lumen
from cathsim.viewing.figure import new_figure, plain_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

logger = logging.getLogger(__name__)

# Notes that tell what was done and leave nothing to be checked by eye.
_FACTS = re.compile(
    r"united from|\d+ degenerate or repeated faces|\d+ faces thinned out|distances every|no target in|target \w+ lies|"
    r"the aorta's course begins in|\d+ of \d+ parts left out, which are no way|what is unsure is marked"
)
PICTURE = "what is unsure is marked in the picture"  # a note, before the path
_PLAIN, _DOUBT, _OPEN = "#1c2a3a", "#c2410c", "#1b6ca8"
_PIXELS = 170  # from the middle to the top of the lumen
_MARGIN = (3e-3, 12e-3)  # m beside and above the lumen
_LINE = 150  # letters of the list of notes
_MOST = 12  # notes that are listed


def doubts(notes: Sequence[str]) -> tuple[str, ...]:
    """The notes of an import that a person should look at: all but those that merely tell what was done."""
    return tuple(note for note in notes if not _FACTS.match(note))


def vessels_named(note: str, names: Sequence[str]) -> tuple[str, ...]:
    """The vessels of which a note speaks; the aorta only where it speaks of no other."""
    vessels = tuple(name for name in names if re.search(rf"\b{re.escape(name)}\b", note, re.IGNORECASE))
    return tuple(name for name in vessels if name != "aorta") or vessels


def draw_import(phantom: Phantom, path: Path | None = None) -> Figure:
    """Draws an imported phantom from three sides with the names of its vessels, open and closed ends, and its doubts.

    A doubt's number stands in the list below and at the vessels of which it speaks, which are drawn in its colour.

    Args:
        path: PNG file to write, or None for the figure only.
    """
    assert phantom.imported is not None, "a phantom of an import"
    report, unsure = phantom.imported, doubts(phantom.imported.notes)
    names = phantom.tree.names
    numbers = {name: [k + 1 for k, note in enumerate(unsure) if name in vessels_named(note, names)] for name in names}
    low, high = phantom.bounds
    half_width = float(np.linalg.norm((high - low)[:2])) / 2 + _MARGIN[0]
    half_height = (high[2] - low[2]) / 2 + _MARGIN[1]
    words = _listed(unsure)
    below = 0.17 * (words.count("\n") + 1) + 0.3
    height = min(3.9 * half_height / half_width, 9.0) + 0.9
    figure = new_figure(figsize=(13.0, height + below), dpi=110, facecolor="white")
    panels = figure.subplots(1, len(VIEWS), sharey=True)
    figure.subplots_adjust(0.05, (below + 0.45) / (height + below), 0.99, 1 - 0.75 / (height + below), 0.03)
    for panel, (label, turn) in zip(panels, VIEWS.items(), strict=True):
        image = render_lumen(phantom, turn, half_width, half_height, half_height / _PIXELS)
        extent = np.array([-half_width, half_width, -half_height, half_height]) * 1e3
        panel.imshow(image, extent=tuple(extent), origin="lower", interpolation="bilinear")
        _draw_vessels(panel, phantom, numbers, turn)
        panel.set_title(label, fontsize=11)
        panel.set_xlabel("mm")
        panel.set_aspect("equal")
        for side in ("top", "right"):
            panel.spines[side].set_visible(False)
    panels[0].set_ylabel("mm, towards the head")
    size = " x ".join(f"{1e3 * side:.0f}" for side in high - low)
    figure.suptitle(
        f"{plain_text(report.file)}: unit {report.unit} ({report.unit_reason}), {report.kind}, {size} mm\n"
        "ring: open end, cross: closed end, arrow: entry",
        fontsize=10,
    )
    figure.text(0.02, 0.01, plain_text(words), fontsize=9, va="bottom", color=_DOUBT if unsure else _PLAIN)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path)
    return figure


def _draw_vessels(panel: Axes, phantom: Phantom, numbers: dict[str, list[int]], turn: float) -> None:
    """Centrelines, names at the far ends, numbers of doubts, and entries in one view."""
    right, _ = camera(turn)
    centre = phantom.bounds.mean(axis=0)
    beside = 0.2 * 1e3 * float(np.ptp(phantom.bounds[:, 2]))  # mm that a name takes
    named: list[tuple[float, float]] = []
    for branch in phantom.tree:
        colour = _DOUBT if numbers[branch.name] else "white"
        line = picture_point(branch.points, centre, right)
        panel.plot(line[:, 0], line[:, 1], color=colour, linewidth=1.8 if numbers[branch.name] else 0.9, alpha=0.9)
        if branch.name == phantom.tree.root.name:
            place = line[len(line) // 2]
        else:
            place = line[-1]
            if branch.open_end:
                panel.plot(*place, "o", color="none", markeredgecolor=_OPEN, markersize=7, markeredgewidth=1.6)
            elif not any(other.parent == branch.name for other in phantom.tree):
                panel.plot(*place, "x", color=_DOUBT, markersize=7, markeredgewidth=1.8)
        doubted = f" ({', '.join(map(str, numbers[branch.name]))})" if numbers[branch.name] else ""
        text = plain_text(branch.name) + doubted
        box: dict[str, Any] = {"facecolor": "white", "alpha": 0.7, "edgecolor": "none", "pad": 0.6}
        rows = sum(abs(x - place[0]) < beside and abs(y - place[1]) < beside / 4 for x, y in named)
        named.append((float(place[0]), float(place[1])))
        panel.annotate(
            text, tuple(place), (6, 4 + 11 * rows), textcoords="offset points", fontsize=8.5, weight="bold", bbox=box,
            color=_DOUBT if numbers[branch.name] else _PLAIN,
        )  # fmt: skip
    for entry in phantom.entries.values():
        begin, end = (picture_point(entry.position + k * entry.direction, centre, right) for k in (0.0, 0.014))
        panel.annotate("", tuple(end), tuple(begin), arrowprops={"arrowstyle": "-|>", "color": _OPEN, "linewidth": 1.8})


def _listed(unsure: Sequence[str]) -> str:
    if not unsure:
        return "nothing is unsure"
    lines = [
        textwrap.fill(f"{number}. {note}", _LINE, subsequent_indent="    ")
        for number, note in enumerate(unsure[:_MOST], start=1)
    ]
    more = len(unsure) - _MOST
    return "\n".join(lines + ([f"and {more} more"] if more > 0 else []))


def with_picture_of_doubts(phantom: Phantom, path: Path) -> Phantom:
    """A phantom whose import is unsure of something, which its first notes say and a picture that the last one names.

    Any other phantom stays as it is.

    Args:
        path: PNG file to draw. Where it cannot be drawn (no matplotlib, no disk space) there is no such note.
    """
    report = phantom.imported
    if report is None or not (unsure := doubts(report.notes)):
        return phantom
    report = replace(report, notes=(*unsure, *(note for note in report.notes if note not in unsure)))
    phantom = replace(phantom, imported=report)
    try:
        draw_import(phantom, path)
    except ModuleNotFoundError as error:
        logger.warning("no picture of the import: %s", error)
        return phantom
    except OSError as error:
        logger.warning("no picture of the import: %s cannot be written (%s).", path, error)
        return phantom
    return replace(phantom, imported=replace(report, notes=(*report.notes, f"{PICTURE} {path}")))
