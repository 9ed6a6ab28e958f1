"""Plots of shape prediction: wires in space from two angles, over the image, the error along them, and trainings."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.report.plots.canvas import new_figure, save_figure

TRUE, PREDICTED = "tab:blue", "tab:orange"
_ANGLES = ((20, -60), (20, 30))  # elevation and azimuth, degrees


def draw_in_space(folder: Path, file: Path) -> None:
    """Draws a network's example curves in space, from two angles.

    Args:
        folder: of the network, with ``examples.npz``.
        file: of the picture.
    """
    with np.load(folder / "examples.npz") as kept:
        count = len(kept["frames"])
        figure = new_figure(4.2 * count, 7.6)
        for column in range(count):
            predicted, true = kept[f"predicted{column}"], kept[f"true{column}"]
            both = np.concatenate((predicted, true))
            middle, half = (both.min(0) + both.max(0)) / 2, (both.max(0) - both.min(0)).max() / 2
            worst = _furthest(predicted, true)
            for row, (elevation, azimuth) in enumerate(_ANGLES):
                axes: Any = figure.add_subplot(2, count, row * count + column + 1, projection="3d")
                axes.plot(*true.T, color=TRUE, linewidth=2, label="true")
                axes.plot(*predicted.T, color=PREDICTED, linewidth=2, label="predicted")
                axes.scatter(*true[0], color=TRUE, s=18)
                axes.scatter(*predicted[0], color=PREDICTED, s=18)
                axes.set(xlabel="x, mm", ylabel="y, mm", zlabel="z, mm")
                for axis, centre in zip("xyz", middle, strict=True):
                    getattr(axes, f"set_{axis}lim")(centre - half, centre + half)
                axes.view_init(elevation, azimuth)
                axes.tick_params(labelsize=7)
                if row == 0:
                    axes.set_title(f"MaxED {worst:.1f} mm", fontsize=10)
                if row == column == 0:
                    axes.legend(frameon=False, fontsize=8)
    save_figure(figure, file)


def draw_reprojections(folder: Path, guide3d: Path, file: Path) -> None:
    """Draws a network's example curves over the images that it saw.

    Args:
        folder: of the network, with ``examples.npz``.
        guide3d: folder of the stage guide3d.
        file: of the picture.
    """
    from pipeline.stages.guide3d.folder import open_dataset

    data = open_dataset(guide3d)
    with np.load(folder / "examples.npz") as kept:
        frames = kept["frames"].tolist()
        figure = new_figure(4.2 * len(frames), 4.6)
        for column, index in enumerate(frames):
            frame = data.frames[index]
            axes = figure.add_subplot(1, len(frames), column + 1)
            line = frame.polyline("a")
            axes.imshow(frame.image("a"), cmap="gray")
            axes.plot(*line.T, color=TRUE, linewidth=1, label="annotated")
            if data.camera_a is not None:
                projected = data.camera_a.project(kept[f"predicted{column}"])
                axes.plot(*projected.T, color=PREDICTED, linewidth=1, label="predicted")
            width, height = frame.size_px["a"]
            axes.set(xlim=(0, width - 1), ylim=(height - 1, 0), xticks=[], yticks=[])
            axes.set_title(frame.label, fontsize=9)
            if column == 0:
                axes.legend(fontsize=8, loc="lower right")
    save_figure(figure, file)


def draw_along(networks: Mapping[str, Mapping[str, Any]], file: Path) -> None:
    """Draws the mean error by arc length from the tip.

    Args:
        networks: name to ``along_mm`` and ``along_error_mm``.
        file: of the picture.
    """
    figure = new_figure(6.8, 4.2)
    axes = figure.subplots()
    for name, told in networks.items():
        axes.plot(told["along_mm"], told["along_error_mm"], label=name)
    axes.set(xlabel="arc length from the tip, mm", ylabel="mean distance, mm", ylim=(0, None))
    axes.legend(frameon=False, fontsize=8)
    axes.grid(alpha=0.3)
    save_figure(figure, file)


def draw_training(networks: Mapping[str, Mapping[str, Any]], file: Path, what: str) -> None:
    """Draws training and validation loss by epoch.

    Args:
        networks: name to ``curve``: epoch, loss and validation an epoch.
        file: of the picture.
        what: is drawn, for the axis.
    """
    figure = new_figure(6.8, 4.2)
    axes = figure.subplots()
    for index, (name, told) in enumerate(networks.items()):
        epochs, losses, held = zip(*told["curve"], strict=True)
        axes.plot(epochs, losses, color=f"C{index}", linestyle=":", linewidth=1)
        if all(value is not None for value in held):
            axes.plot(epochs, held, color=f"C{index}", label=name)
    axes.plot([], [], color="0.4", linestyle=":", linewidth=1, label="training")
    axes.set(xlabel="epoch", ylabel=what)
    axes.set_yscale("log")
    axes.legend(frameon=False, fontsize=8)
    axes.grid(alpha=0.3)
    save_figure(figure, file)


def _furthest(predicted: np.ndarray, true: np.ndarray) -> float:
    from guide3d.geometry.metrics import max_ed

    return max_ed(predicted, true)
