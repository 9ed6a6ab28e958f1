"""Plots of reconstructed wires: errors along the wire, overlays on both images, and example pairs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.plots.canvas import chart, new_figure, save_figure

Array = NDArray[np.float64]

_COLOURS = {"camera A": "tab:blue", "camera B": "tab:orange"}
_LINES = (("red", "-"), ("cyan", ":"))  # of the two ways to reconstruct


@dataclass(frozen=True, eq=False)
class Overlay:
    """One camera's image with what was drawn and what came of it."""

    title: str
    image: NDArray[np.uint8]  # (h, w) uint8
    annotation: Array  # (n, 2) px
    curves: Mapping[str, Array]  # name to (m, 2) px, reprojected


def draw_along(lines: Mapping[str, Array], file: Path) -> None:
    """Draws mean and spread of the reprojection error along the wire: name to px of shape (pairs, places)."""
    with chart(file, 7.2, 4.0) as axes:
        for index, (name, values) in enumerate(lines.items()):
            mean, spread = values.mean(axis=0), values.std(axis=0)
            places = np.arange(1, len(mean) + 1)
            colour, low = _COLOURS.get(name, f"C{index}"), np.maximum(mean - spread, 0.0)
            axes.plot(places, mean, marker=".", color=colour, label=f"{name}, mean")
            axes.fill_between(places, low, mean + spread, color=colour, alpha=0.2, linewidth=0)
        axes.set(xlabel="place along the wire, from the tip", ylabel="reprojection, px", ylim=(0, None))


def draw_overlays(pairs: Sequence[tuple[Overlay, Overlay]], file: Path) -> None:
    """Draws pairs of images with their curves, camera A above camera B, a column each."""
    figure = new_figure(3.4 * len(pairs), 7.2)
    grid = figure.subplots(2, len(pairs), squeeze=False)
    for column, pair in enumerate(pairs):
        for row, overlay in enumerate(pair):
            axes = grid[row, column]
            axes.imshow(overlay.image, cmap="gray", vmin=0, vmax=255)
            axes.plot(*overlay.annotation.T, color="yellow", linewidth=4.0, alpha=0.35, label="annotation")
            for (name, curve), (colour, line) in zip(overlay.curves.items(), _LINES, strict=False):
                axes.plot(*curve.T, color=colour, linestyle=line, linewidth=1.0, label=name)
            axes.set(xlim=(0, overlay.image.shape[1] - 1), ylim=(overlay.image.shape[0] - 1, 0), xticks=[], yticks=[])
            axes.set_title(overlay.title, fontsize=8)
            if row == column == 0:
                axes.legend(fontsize=7, loc="lower left", framealpha=0.7)
    save_figure(figure, file)


def draw_samples(rows: Sequence[tuple[str, NDArray[np.uint8], NDArray[np.uint8]]], file: Path) -> None:
    """Draws example pairs of images, a column each: title, camera A's and camera B's image."""
    figure = new_figure(3.2 * len(rows), 6.6)
    grid = figure.subplots(2, len(rows), squeeze=False)
    for column, (title, *images) in enumerate(rows):
        for row, image in enumerate(images):
            grid[row, column].imshow(image, cmap="gray", vmin=0, vmax=255)
            grid[row, column].set(xticks=[], yticks=[])
        grid[0, column].set_title(title, fontsize=9)
    save_figure(figure, file)
