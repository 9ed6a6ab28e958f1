"""Plots of segmentation: what was found and missed, over the image, and Dice by kind of image."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.report.plots.canvas import new_figure, save_figure

# Both found it, only the network did, only the annotation did.
_COLOURS = {"right": (60, 180, 75), "too much": (245, 130, 48), "missed": (67, 99, 216)}
_MARGIN_PX = 30


def overlay(image: np.ndarray, predicted: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Colours an image's pixels by what was found there.

    Args:
        image: (h, w) uint8.
        predicted: (h, w), wire where it is not 0.
        true: likewise.

    Returns:
        (h, w, 3) uint8.
    """
    told = np.repeat(image[..., None], 3, axis=2)
    a, b = predicted != 0, true != 0
    for part, colour in zip((a & b, a & ~b, b & ~a), _COLOURS.values(), strict=True):
        told[part] = colour
    return told


def draw_examples(folders: Mapping[str, Path], file: Path) -> None:
    """Draws each network's example images, cut about the wire.

    Args:
        folders: name of a network to its folder, with ``examples.npz``.
        file: of the picture.
    """
    columns = 3
    figure = new_figure(4.0 * columns, 3.7 * len(folders))
    axes = figure.subplots(len(folders), columns, squeeze=False)
    for row, (name, folder) in enumerate(folders.items()):
        with np.load(folder / "examples.npz") as kept:
            for column, place in enumerate(axes[row]):
                image, predicted, true = (kept[f"{key}{column}"] for key in ("image", "predicted", "true"))
                rows, cells = _window(predicted, true)
                place.imshow(overlay(image, predicted, true)[rows, cells])
                place.set_title(f"{name}: Dice {100 * kept['dice'][column]:.1f} %", fontsize=9)
                place.set(xticks=[], yticks=[])
    for name, colour in _COLOURS.items():
        axes[0, 0].plot([], [], "s", color=np.array(colour) / 255, label=name)
    axes[0, 0].legend(fontsize=8, loc="lower right")
    save_figure(figure, file)


def _window(predicted: np.ndarray, true: np.ndarray) -> tuple[slice, slice]:
    """A square about all wire in either mask."""
    places = np.argwhere((predicted != 0) | (true != 0))
    if not len(places):
        return slice(None), slice(None)
    low, high = places.min(0) - _MARGIN_PX, places.max(0) + _MARGIN_PX
    side = min(int((high - low).max()), *true.shape)
    corner = np.clip((low + high - side) // 2, 0, np.array(true.shape) - side)
    return slice(corner[0], corner[0] + side), slice(corner[1], corner[1] + side)


def draw_kinds(networks: Mapping[str, Mapping[str, Any]], file: Path) -> None:
    """Draws Dice by wire and fluid.

    Args:
        networks: name to ``by_kind``: kind to mean and standard deviation, %.
        file: of the picture.
    """
    figure = new_figure(6.8, 4.2)
    axes = figure.subplots()
    kinds = sorted({kind for told in networks.values() for kind in told["by_kind"]})
    width = 0.8 / max(1, len(networks))
    for index, (name, told) in enumerate(networks.items()):
        means = [told["by_kind"].get(kind, [np.nan, 0.0]) for kind in kinds]
        places = np.arange(len(kinds)) + width * (index - (len(networks) - 1) / 2)
        axes.bar(places, [m for m, _ in means], width, yerr=[s for _, s in means], label=name, capsize=2)
    axes.set_xticks(range(len(kinds)), kinds, fontsize=8)
    axes.set(ylabel="Dice, %", ylim=(0, 105))
    axes.legend(frameon=False, fontsize=8, loc="lower right")
    axes.grid(alpha=0.3, axis="y")
    save_figure(figure, file)
