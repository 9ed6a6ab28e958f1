"""Plots of segmentation: what was found and missed, over the image, and Dice by kind of image."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.plots.canvas import chart, new_figure, save_figure, window

# Both found it, only the network did, only the annotation did.
_COLOURS = {"right": (60, 180, 75), "too much": (245, 130, 48), "missed": (67, 99, 216)}
_MARGIN_PX = 30
_EXAMPLES = 3


def overlay(image: np.ndarray, predicted: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Colours an image's pixels by what was found there.

    Args:
        image: (h, w) uint8.
        predicted, true: (h, w), wire where they are not 0.

    Returns:
        (h, w, 3) uint8.
    """
    coloured = np.repeat(image[..., None], 3, axis=2)
    a, b = predicted != 0, true != 0
    for part, colour in zip((a & b, a & ~b, b & ~a), _COLOURS.values(), strict=True):
        coloured[part] = colour
    return coloured


def draw_examples(folders: Mapping[str, Path], file: Path) -> None:
    """Draws each network's example images, cut about the wire: its name to its folder, with ``examples.npz``."""
    figure = new_figure(4.0 * _EXAMPLES, 3.7 * len(folders))
    grid = figure.subplots(len(folders), _EXAMPLES, squeeze=False)
    for (name, folder), line in zip(folders.items(), grid, strict=True):
        with np.load(folder / "examples.npz") as kept:
            for column, axes in enumerate(line):
                image, predicted, true = (kept[f"{key}{column}"] for key in ("image", "predicted", "true"))
                wire = np.argwhere((predicted != 0) | (true != 0))[:, ::-1]
                cut = window(wire, true.shape, _MARGIN_PX) if len(wire) else (slice(None), slice(None))
                axes.imshow(overlay(image, predicted, true)[cut])
                axes.set_title(f"{name}: Dice {100 * kept['dice'][column]:.1f} %", fontsize=9)
                axes.set(xticks=[], yticks=[])
    for name, colour in _COLOURS.items():
        grid[0, 0].plot([], [], "s", color=np.array(colour) / 255, label=name)
    grid[0, 0].legend(fontsize=8, loc="lower right")
    save_figure(figure, file)


def draw_kinds(networks: Mapping[str, Mapping[str, Any]], file: Path) -> None:
    """Draws Dice by wire and fluid: name of a network to ``by_kind``, kind to mean and standard deviation, %."""
    kinds = sorted({kind for outcome in networks.values() for kind in outcome["by_kind"]})
    width = 0.8 / max(1, len(networks))
    with chart(file, grid="y", loc="lower right") as axes:
        for index, (name, outcome) in enumerate(networks.items()):
            means, spreads = np.array([outcome["by_kind"].get(kind, [np.nan, 0.0]) for kind in kinds]).T
            places = np.arange(len(kinds)) + width * (index - (len(networks) - 1) / 2)
            axes.bar(places, means, width, yerr=spreads, label=name, capsize=2)
        axes.set_xticks(range(len(kinds)), kinds, fontsize=8)
        axes.set(ylabel="Dice, %", ylim=(0, 105))
