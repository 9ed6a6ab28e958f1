"""Plots of SplineFormer: curves beside a traced mask, errors by reader and disturbance, attention over the image."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.plots.canvas import new_figure, save_figure, window

TRUE, MASK, TRACED, SPLINE = "tab:green", (1.0, 0.55, 0.1), "tab:red", "tab:blue"
_MARGIN_PX = 40
_GREY_TAILS_PCT = (1, 99)


def draw_comparison(examples: Path, rival: str, variants: Sequence[str], labels: Mapping[str, str], file: Path) -> None:
    """Draws images with the traced mask above and the splines below.

    Args:
        examples: ``examples.npz`` of the comparison.
        rival: name of the segmentation network.
        labels: names as they are shown.
    """
    with np.load(examples) as kept:
        kinds = [str(kind).replace("_", " ") for kind in kept["kinds"]]
        figure = new_figure(4.3 * len(kinds), 4.1 * (1 + len(variants)))
        grid = figure.subplots(1 + len(variants), len(kinds), squeeze=False)
        for column, kind in enumerate(kinds):
            image, true = kept[f"image{column}"], kept[f"true{column}"]
            rows, cells = window(true, image.shape, _MARGIN_PX)
            for row, name in enumerate((rival, *variants)):
                axes, points = grid[row][column], kept[f"points{column}_{name}"]
                low, high = np.percentile(image[rows, cells], _GREY_TAILS_PCT)
                axes.imshow(image, cmap="gray", vmin=low, vmax=high)
                if name == rival:
                    shown = np.zeros((*image.shape, 4))
                    shown[kept[f"mask{column}"] > 0] = (*MASK, 0.75)
                    axes.imshow(shown)
                axes.plot(*true.T, color=TRUE, linewidth=1.0, linestyle=(0, (4, 3)), label="annotated")
                if len(points):
                    colour = TRACED if name == rival else SPLINE
                    axes.plot(*points.T, color=colour, linewidth=1.3, label=labels[name])
                    axes.plot(*points[0], "o", color=colour, markersize=5, fillstyle="none")
                if name != rival and len(kept[f"control{column}_{name}"]):
                    axes.plot(*kept[f"control{column}_{name}"].T, ".", color=SPLINE, markersize=3)
                axes.set(xlim=(cells.start, cells.stop), ylim=(rows.stop, rows.start), xticks=[], yticks=[])
                axes.set_title(labels[name] + ("" if kind == "none" else f", {kind}"), fontsize=10)
        grid[0][0].legend(fontsize=8, loc="lower right")
    save_figure(figure, file)


def draw_attention(examples: Path, variants: Sequence[str], labels: Mapping[str, str], file: Path) -> None:
    """Draws the attention of each variant over the images; arguments as of `draw_comparison`."""
    with np.load(examples) as kept:
        columns = len(kept["kinds"])
        figure = new_figure(4.0 * columns, 4.0 * len(variants))
        grid = figure.subplots(len(variants), columns, squeeze=False)
        for row, name in enumerate(variants):
            for column in range(columns):
                axes, image = grid[row][column], kept[f"image{column}"]
                seen = kept[f"attention{column}_{name}"] / 255.0
                axes.imshow(image, cmap="gray")
                height, width = image.shape
                extent = (-0.5, width - 0.5, height - 0.5, -0.5)
                axes.imshow(seen, cmap="inferno", alpha=0.75 * (seen > 0), extent=extent)
                points = kept[f"points{column}_{name}"]
                if len(points):
                    axes.plot(*points.T, color="tab:cyan", linewidth=1.0)
                axes.set(xticks=[], yticks=[])
                axes.set_title(labels[name], fontsize=10)
    save_figure(figure, file)


def draw_errors(outcome: Mapping[str, Mapping[str, Any]], labels: Mapping[str, str], file: Path) -> None:
    """Draws the share of images below an error, and the median errors under each disturbance.

    Args:
        outcome: disturbance to reader to its figures: see `splineformer.comparison.evaluation`.
        labels: names of the readers as they are shown.
    """
    figure = new_figure(11.0, 4.0)
    means, tips, medians = figure.subplots(1, 3)
    for axes, key, name in ((means, "mean_errors_px", "mean curve error"), (tips, "tip_errors_px", "tip error")):
        for reader, of_reader in outcome["none"].items():
            errors = np.sort(of_reader[key])
            # images in which nothing was found have no error: the curve ends below 100 %
            shares = 100 * np.arange(1, len(errors) + 1) / max(of_reader["n"], 1)
            axes.step(errors, shares, where="post", label=labels[reader])
        axes.set(xlabel=f"{name}, px", ylabel="images below, %", ylim=(0, 102))
        if any(of_reader[key] for of_reader in outcome["none"].values()):  # a logarithmic axis needs a value
            axes.set(xscale="log")
        axes.grid(alpha=0.3)
    means.legend(frameon=False, fontsize=8, loc="lower right")
    readers = list(outcome["none"])
    width = 0.8 / len(readers)
    for index, reader in enumerate(readers):
        places = np.arange(len(outcome)) + width * (index - (len(readers) - 1) / 2)
        known = [of_kind[reader]["median_px"] for of_kind in outcome.values()]
        heights = [np.nan if error is None else error for error in known]
        medians.bar(places, heights, width, label=labels[reader])
    medians.set_xticks(range(len(outcome)), [kind.replace("_", " ") for kind in outcome], fontsize=8)
    medians.set(ylabel="median of the mean curve error, px")
    if any(one["median_px"] is not None for of_kind in outcome.values() for one in of_kind.values()):
        medians.set(yscale="log")
    medians.grid(alpha=0.3, axis="y")
    save_figure(figure, file)
