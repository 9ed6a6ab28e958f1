"""Plots of shape prediction: wires in space, over the image, the error along them, and trainings of networks."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.plots import canvas
from pipeline.plots.canvas import chart, new_figure, save_figure

TRUE, PREDICTED = "tab:blue", "tab:orange"


def draw_in_space(folder: Path, file: Path) -> None:
    """Draws the example curves of a network's folder, ``examples.npz``, in space from two angles."""
    from guide3d.geometry.metrics import max_ed

    wires = []
    with np.load(folder / "examples.npz") as kept:
        for column in range(len(kept["frames"])):
            true, predicted = kept[f"true{column}"], kept[f"predicted{column}"]
            wires.append((f"MaxED {max_ed(predicted, true):.1f} mm", {"true": true, "predicted": predicted}))
    canvas.draw_in_space(wires, file)


def draw_reprojections(folder: Path, guide3d: Path, file: Path) -> None:
    """Draws a network's example curves over the images that it saw.

    Args:
        folder: of the network, with ``examples.npz``.
        guide3d: folder of the stage guide3d.
    """
    from pipeline.stages.guide3d.folder import open_dataset

    data = open_dataset(guide3d)
    with np.load(folder / "examples.npz") as kept:
        frames = kept["frames"].tolist()
        figure = new_figure(4.2 * len(frames), 4.6)
        for column, index in enumerate(frames):
            frame = data.frames[index]
            axes = figure.add_subplot(1, len(frames), column + 1)
            axes.imshow(frame.image("a"), cmap="gray")
            axes.plot(*frame.polyline("a").T, color=TRUE, linewidth=1, label="annotated")
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
    """Draws the mean error by arc length from the tip: name of a network to ``along_mm`` and ``along_error_mm``."""
    with chart(file) as axes:
        for name, outcome in networks.items():
            axes.plot(outcome["along_mm"], outcome["along_error_mm"], label=name)
        axes.set(xlabel="arc length from the tip, mm", ylabel="mean distance, mm", ylim=(0, None))


def draw_training(networks: Mapping[str, Mapping[str, Any]], file: Path, quantity: str) -> None:
    """Draws training and validation loss by epoch.

    Args:
        networks: name to ``curve``: epoch, loss and validation an epoch.
        quantity: label of the axis of losses.
    """
    with chart(file) as axes:
        for index, (name, outcome) in enumerate(networks.items()):
            epochs, losses, held = zip(*outcome["curve"], strict=True)
            axes.plot(epochs, losses, color=f"C{index}", linestyle=":", linewidth=1)
            if all(value is not None for value in held):
                axes.plot(epochs, held, color=f"C{index}", label=name)
        axes.plot([], [], color="0.4", linestyle=":", linewidth=1, label="training")
        axes.set(xlabel="epoch", ylabel=quantity, yscale="log")
