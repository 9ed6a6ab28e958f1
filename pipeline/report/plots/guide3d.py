"""Plots of reconstructed wires: errors along the wire, overlays on both images, and the wire in space."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.report.plots.canvas import new_figure, save_figure

Array = NDArray[np.float64]

_COLOURS = {"camera A": "tab:blue", "camera B": "tab:orange"}
_VIEWING = ((20.0, -80.0), (20.0, 10.0))  # elevation and azimuth of the two angles, degrees


@dataclass(frozen=True, eq=False)
class Overlay:
    """One camera's image with what was drawn and what came of it.

    Attributes:
        title: above it.
        image: (h, w) uint8.
        annotation: (n, 2) px.
        curves: name to (m, 2) px, reprojected.
    """

    title: str
    image: NDArray[np.uint8]
    annotation: Array
    curves: Mapping[str, Array]


def draw_along(lines: Mapping[str, Array], file: Path, *, x_label: str, y_label: str) -> None:
    """Draws mean and spread of an error along the wire.

    Args:
        lines: name to errors of shape (pairs, places).
        file: of the picture.
        x_label: of the axis from the tip on.
        y_label: of the error.
    """
    figure = new_figure(7.2, 4.0)
    axes = figure.subplots()
    for index, (name, values) in enumerate(lines.items()):
        mean, spread = values.mean(axis=0), values.std(axis=0)
        places = np.arange(1, len(mean) + 1)
        colour = _COLOURS.get(name, f"C{index}")
        axes.plot(places, mean, marker=".", color=colour, label=f"{name}, mean")
        axes.fill_between(places, np.maximum(mean - spread, 0.0), mean + spread, color=colour, alpha=0.2, linewidth=0)
    axes.set(xlabel=x_label, ylabel=y_label, ylim=(0, None))
    axes.legend(frameon=False, fontsize=8)
    axes.grid(alpha=0.3)
    save_figure(figure, file)


def draw_segments(groups: Mapping[str, Array], file: Path, *, y_label: str) -> None:
    """Draws the distribution of an error per segment of the wire.

    Args:
        groups: name to errors of shape (pairs, segments).
        file: of the picture.
        y_label: of the error.
    """
    figure = new_figure(7.2, 4.0)
    axes = figure.subplots()
    for index, (name, values) in enumerate(groups.items()):
        places = np.arange(1, values.shape[1] + 1) + (index - (len(groups) - 1) / 2) * 0.35
        axes.boxplot(
            values, positions=places, widths=0.28, showfliers=False, manage_ticks=False, patch_artist=True,
            boxprops={"facecolor": f"C{index}", "alpha": 0.5}, medianprops={"color": "black"},
        )  # fmt: skip
        axes.plot([], [], color=f"C{index}", linewidth=6, alpha=0.5, label=name)
    axes.set(xlabel="segment of the wire, from the tip", ylabel=y_label, ylim=(0, None))
    axes.legend(frameon=False, fontsize=8)
    axes.grid(alpha=0.3, axis="y")
    save_figure(figure, file)


def draw_overlays(pairs: Sequence[tuple[Overlay, Overlay]], file: Path) -> None:
    """Draws pairs of images, camera A above camera B.

    Args:
        pairs: a column each.
        file: of the picture.
    """
    figure = new_figure(3.4 * len(pairs), 7.2)
    grid = figure.subplots(2, len(pairs), squeeze=False)
    for column, pair in enumerate(pairs):
        for row, overlay in enumerate(pair):
            axes = grid[row, column]
            axes.imshow(overlay.image, cmap="gray", vmin=0, vmax=255)
            axes.plot(*overlay.annotation.T, color="yellow", linewidth=4.0, alpha=0.35, label="annotation")
            for index, (name, curve) in enumerate(overlay.curves.items()):
                axes.plot(
                    *curve.T, color=("red", "cyan")[index], linestyle=("-", ":")[index], linewidth=1.0, label=name
                )
            axes.set(xlim=(0, overlay.image.shape[1] - 1), ylim=(overlay.image.shape[0] - 1, 0), xticks=[], yticks=[])
            axes.set_title(overlay.title, fontsize=8)
            if row == column == 0:
                axes.legend(fontsize=7, loc="lower left", framealpha=0.7)
    save_figure(figure, file)


def draw_in_space(wires: Sequence[tuple[str, Mapping[str, Array]]], file: Path) -> None:
    """Draws wires in space from two angles.

    Args:
        wires: title and, by name, curves of shape (n, 3) mm from the tip; a column each.
        file: of the picture.
    """
    figure = new_figure(4.0 * len(wires), 7.6)
    for column, (title, curves) in enumerate(wires):
        every = np.concatenate(list(curves.values()))
        middle, reach = (every.max(axis=0) + every.min(axis=0)) / 2, np.ptp(every, axis=0).max() / 2
        for row, (elevation, azimuth) in enumerate(_VIEWING):
            axes = figure.add_subplot(2, len(wires), row * len(wires) + column + 1, projection="3d")
            for index, (name, curve) in enumerate(curves.items()):
                style = {"color": ("0.4", "tab:red", "tab:cyan")[index % 3], "linewidth": (3.0, 1.2, 1.0)[index % 3]}
                axes.plot(*curve.T, label=name, alpha=0.8, **style)
                axes.plot(*curve[:1].T, marker="o", markersize=3, color=style["color"])
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


def draw_samples(rows: Sequence[tuple[str, NDArray[np.uint8], NDArray[np.uint8]]], file: Path) -> None:
    """Draws example pairs of images, plain.

    Args:
        rows: title, camera A's and camera B's image; a column each.
        file: of the picture.
    """
    figure = new_figure(3.2 * len(rows), 6.6)
    grid = figure.subplots(2, len(rows), squeeze=False)
    for column, (title, *images) in enumerate(rows):
        for row, image in enumerate(images):
            grid[row, column].imshow(image, cmap="gray", vmin=0, vmax=255)
            grid[row, column].set(xticks=[], yticks=[])
        grid[0, column].set_title(title, fontsize=9)
    save_figure(figure, file)
