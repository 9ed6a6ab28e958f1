"""Plots of SplineFormer: curves beside a traced mask, errors by reader and disturbance, attention over the image."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.report.plots.canvas import new_figure, save_figure

TRUE, MASK, TRACED, SPLINE = "tab:green", (1.0, 0.55, 0.1), "tab:red", "tab:blue"
_MARGIN_PX = 40
_GREY_TAILS_PCT = (1, 99)


def draw_comparison(examples: Path, rival: str, variants: Sequence[str], labels: Mapping[str, str], file: Path) -> None:
    """Draws images with the traced mask above and the splines below.

    Args:
        examples: ``examples.npz`` of the comparison.
        rival: name of the segmentation network.
        variants: names of the variants.
        labels: names as they are shown.
        file: of the picture.
    """
    with np.load(examples) as kept:
        columns = len(kept["kinds"])
        figure = new_figure(4.3 * columns, 4.1 * (1 + len(variants)))
        grid = figure.subplots(1 + len(variants), columns, squeeze=False)
        for column in range(columns):
            image, true = kept[f"image{column}"], kept[f"true{column}"]
            rows, cells = _window(true, image.shape)
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
                kind = str(kept["kinds"][column]).replace("_", " ")
                axes.set_title(labels[name] + ("" if kind == "none" else f", {kind}"), fontsize=10)
        grid[0][0].legend(fontsize=8, loc="lower right")
    save_figure(figure, file)


def _window(points: np.ndarray, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """A square about a curve, inside the image."""
    low, high = points.min(0) - _MARGIN_PX, points.max(0) + _MARGIN_PX
    side = min(int((high - low).max()), *shape)
    corner = np.clip((low + high - side) / 2, 0, np.array(shape[::-1]) - side).astype(int)
    return slice(corner[1], corner[1] + side), slice(corner[0], corner[0] + side)


def draw_attention(examples: Path, variants: Sequence[str], labels: Mapping[str, str], file: Path) -> None:
    """Draws where each variant looks.

    Args:
        examples: ``examples.npz`` of the comparison.
        variants: names of the variants.
        labels: names as they are shown.
        file: of the picture.
    """
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
                axes.imshow(
                    seen, cmap="inferno", alpha=0.75 * (seen > 0), extent=(-0.5, width - 0.5, height - 0.5, -0.5)
                )
                points = kept[f"points{column}_{name}"]
                if len(points):
                    axes.plot(*points.T, color="tab:cyan", linewidth=1.0)
                axes.set(xticks=[], yticks=[])
                axes.set_title(labels[name], fontsize=10)
    save_figure(figure, file)


def draw_errors(outcome: Mapping[str, Mapping[str, Any]], labels: Mapping[str, str], file: Path) -> None:
    """Draws the share of images below an error, and the median errors under each disturbance.

    Args:
        outcome: disturbance to reader to what `pipeline.stages.networks.comparison.compare` tells.
        labels: names of the readers as they are shown.
        file: of the picture.
    """
    figure = new_figure(11.0, 4.0)
    places = figure.subplots(1, 3)
    for axes, key, name in (
        (places[0], "mean_errors_px", "mean curve error"),
        (places[1], "tip_errors_px", "tip error"),
    ):
        for reader, told in outcome["none"].items():
            errors = np.sort(told[key])
            # images in which nothing was found have no error: the curve ends below 100 %
            axes.step(
                errors, 100 * np.arange(1, len(errors) + 1) / max(told["n"], 1), where="post", label=labels[reader]
            )
        axes.set(xlabel=f"{name}, px", ylabel="images below, %", ylim=(0, 102))
        if any(told[key] for told in outcome["none"].values()):  # a logarithmic axis needs a value
            axes.set(xscale="log")
        axes.grid(alpha=0.3)
    places[0].legend(frameon=False, fontsize=8, loc="lower right")
    readers = list(outcome["none"])
    width = 0.8 / len(readers)
    for index, reader in enumerate(readers):
        medians = [told[reader]["median_px"] for told in outcome.values()]
        heights = [np.nan if median is None else median for median in medians]
        places[2].bar(
            np.arange(len(outcome)) + width * (index - (len(readers) - 1) / 2), heights, width, label=labels[reader]
        )
    places[2].set_xticks(range(len(outcome)), [kind.replace("_", " ") for kind in outcome], fontsize=8)
    places[2].set(ylabel="median of the mean curve error, px")
    if any(one["median_px"] is not None for told in outcome.values() for one in told.values()):
        places[2].set(yscale="log")
    places[2].grid(alpha=0.3, axis="y")
    save_figure(figure, file)
