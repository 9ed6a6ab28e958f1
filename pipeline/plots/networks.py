"""Plots of networks on images: what they find in pixels, as curves and in space, their errors and trainings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.plots import canvas
from pipeline.plots.canvas import chart, new_figure, save_figure, window

# Both found it, only the network did, only the annotation did.
_COLOURS = {"right": (60, 180, 75), "too much": (245, 130, 48), "missed": (67, 99, 216)}
_MASK_MARGIN_PX = 30
_EXAMPLES = 3


def overlay(image: np.ndarray, predicted: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Colours an image, (h, w) uint8 to (h, w, 3), by what was found and is true where (h, w) arrays are not 0."""
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
        with np.load(folder / "examples.npz") as arrays:
            for column, axes in enumerate(line):
                image, predicted, true = (arrays[f"{key}{column}"] for key in ("image", "predicted", "true"))
                wire = np.argwhere((predicted != 0) | (true != 0))[:, ::-1]
                cut = window(wire, true.shape, _MASK_MARGIN_PX) if len(wire) else (slice(None), slice(None))
                axes.imshow(overlay(image, predicted, true)[cut])
                axes.set_title(f"{name}: Dice {100 * arrays['dice'][column]:.1f} %", fontsize=9)
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


TRUE, PREDICTED = "tab:blue", "tab:orange"


def draw_in_space(folder: Path, file: Path) -> None:
    """Draws the example curves of a network's folder, ``examples.npz``, in space from two angles."""
    from guide3d.geometry.metrics import max_ed

    wires = []
    with np.load(folder / "examples.npz") as arrays:
        for column in range(len(arrays["frames"])):
            true, predicted = arrays[f"true{column}"], arrays[f"predicted{column}"]
            wires.append((f"MaxED {max_ed(predicted, true):.1f} mm", {"true": true, "predicted": predicted}))
    canvas.draw_in_space(wires, file)


def draw_reprojections(folder: Path, guide3d: Path, file: Path) -> None:
    """Draws a network's example curves (``examples.npz``) over the images of the stage guide3d's folder that it saw."""
    from pipeline.stages.guide3d.folder import open_dataset

    data = open_dataset(guide3d)
    with np.load(folder / "examples.npz") as arrays:
        frames = arrays["frames"].tolist()
        figure = new_figure(4.2 * len(frames), 4.6)
        for column, index in enumerate(frames):
            frame = data.frames[index]
            axes = figure.add_subplot(1, len(frames), column + 1)
            axes.imshow(frame.image("a"), cmap="gray")
            axes.plot(*frame.polyline("a").T, color=TRUE, linewidth=1, label="annotated")
            if data.camera_a is not None:
                projected = data.distort("a", data.camera_a.project(arrays[f"predicted{column}"]))
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


ANNOTATED, MASK, TRACED, SPLINE = "tab:green", (1.0, 0.55, 0.1), "tab:red", "tab:blue"
_MARGIN_PX = 40
_GREY_TAILS_PCT = (1, 99)


def draw_comparison(examples: Path, rival: str, variants: Sequence[str], labels: Mapping[str, str], file: Path) -> None:
    """Draws images of ``examples.npz`` with the mask traced by the rival above and the variants' splines below."""
    with np.load(examples) as arrays:
        kinds = [str(kind).replace("_", " ") for kind in arrays["kinds"]]
        figure = new_figure(4.3 * len(kinds), 4.1 * (1 + len(variants)))
        grid = figure.subplots(1 + len(variants), len(kinds), squeeze=False)
        for column, kind in enumerate(kinds):
            image, true = arrays[f"image{column}"], arrays[f"true{column}"]
            rows, cells = window(true, image.shape, _MARGIN_PX)
            for row, name in enumerate((rival, *variants)):
                axes, points = grid[row][column], arrays[f"points{column}_{name}"]
                low, high = np.percentile(image[rows, cells], _GREY_TAILS_PCT)
                axes.imshow(image, cmap="gray", vmin=low, vmax=high)
                if name == rival:
                    mask_layer = np.zeros((*image.shape, 4))
                    mask_layer[arrays[f"mask{column}"] > 0] = (*MASK, 0.75)
                    axes.imshow(mask_layer)
                axes.plot(*true.T, color=ANNOTATED, linewidth=1.0, linestyle=(0, (4, 3)), label="annotated")
                if len(points):
                    colour = TRACED if name == rival else SPLINE
                    axes.plot(*points.T, color=colour, linewidth=1.3, label=labels[name])
                    axes.plot(*points[0], "o", color=colour, markersize=5, fillstyle="none")
                if name != rival and len(arrays[f"control{column}_{name}"]):
                    axes.plot(*arrays[f"control{column}_{name}"].T, ".", color=SPLINE, markersize=3)
                axes.set(xlim=(cells.start, cells.stop), ylim=(rows.stop, rows.start), xticks=[], yticks=[])
                axes.set_title(labels[name] + ("" if kind == "none" else f", {kind}"), fontsize=10)
        grid[0][0].legend(fontsize=8, loc="lower right")
    save_figure(figure, file)


def draw_attention(examples: Path, variants: Sequence[str], labels: Mapping[str, str], file: Path) -> None:
    """Draws the attention of each variant over the images; arguments as of `draw_comparison`."""
    with np.load(examples) as arrays:
        columns = len(arrays["kinds"])
        figure = new_figure(4.0 * columns, 4.0 * len(variants))
        grid = figure.subplots(len(variants), columns, squeeze=False)
        for row, name in enumerate(variants):
            for column in range(columns):
                axes, image = grid[row][column], arrays[f"image{column}"]
                seen = arrays[f"attention{column}_{name}"] / 255.0
                axes.imshow(image, cmap="gray")
                height, width = image.shape
                extent = (-0.5, width - 0.5, height - 0.5, -0.5)
                axes.imshow(seen, cmap="inferno", alpha=0.75 * (seen > 0), extent=extent)
                points = arrays[f"points{column}_{name}"]
                if len(points):
                    axes.plot(*points.T, color="tab:cyan", linewidth=1.0)
                axes.set(xticks=[], yticks=[])
                axes.set_title(labels[name], fontsize=10)
    save_figure(figure, file)
