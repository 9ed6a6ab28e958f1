"""Reprojection of a wire in space: distances in the images, and the report of them as numbers and as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw
from scipy.spatial import cKDTree

from guide3d.atomic_file import whole_file
from guide3d.geometry.camera import Camera
from guide3d.geometry.polyline import arc_length, at_length

if TYPE_CHECKING:
    from guide3d.reconstruction.reconstruction import Reconstruction

Array = NDArray[np.float64]

FINE = 1000
PANEL_PX = 512
CHART_PX = 220
ANNOTATION, CURVE = (230, 60, 50), (30, 110, 220)


def distances_to(polyline: ArrayLike, points: ArrayLike) -> Array:
    """Returns the distances (m,) of points (m, d) from a polyline (n, d)."""
    line, wanted = np.asarray(polyline, dtype=float), np.asarray(points, dtype=float)
    # the nearest vertex belongs to the nearest segment only where vertices are dense
    along = arc_length(line)
    line = at_length(line, np.union1d(along, np.linspace(0.0, along[-1], FINE)))
    near = np.atleast_1d(cKDTree(line).query(wanted)[1])
    best = np.full(len(wanted), np.inf)
    for first in (np.clip(near - 1, 0, len(line) - 2), np.clip(near, 0, len(line) - 2)):
        start, step = line[first], line[first + 1] - line[first]
        share = np.clip(((wanted - start) * step).sum(1) / np.maximum((step * step).sum(1), 1e-300), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(wanted - start - share[:, None] * step, axis=1))
    return best


def numbers(result: Reconstruction) -> dict[str, Any]:
    """Returns a reconstruction's figures as plain numbers: reprojection, coverage, uncertainty and warnings."""
    figures: dict[str, Any] = {}
    for letter, residual in (("a", result.residual_a_px), ("b", result.residual_b_px)):
        figures[f"mean_px_{letter}"] = float(residual.mean())
        figures[f"p95_px_{letter}"] = float(np.quantile(residual, 0.95))
        figures[f"max_px_{letter}"] = float(residual.max())
    figures["coverage"] = result.coverage
    figures["coverage_a"], figures["coverage_b"] = result.coverage_a, result.coverage_b
    figures["tangent_share_a"], figures["tangent_share_b"] = result.tangent_share
    figures["epipolar_px"] = result.match.residual_px
    figures["length_mm"] = result.length_mm
    figures["mean_sd_mm"] = float(result.sd_mm.mean())
    figures["noise_px"] = result.noise_px
    figures["accepted"] = bool(result.accepted)
    figures["warnings"] = list(result.warnings)
    return figures


def picture(
    cameras: tuple[Camera, Camera],
    annotations: Sequence[ArrayLike],
    result: Reconstruction,
    images: Sequence[NDArray[np.uint8] | None] = (None, None),
) -> Image.Image:
    """Draws both views with the annotation (red) and the reprojected curve (blue), and the errors along the wire below.

    Args:
        annotations: per view (n, 2) px.
        images: per view the X-ray image (height, width), or None.

    Returns:
        An RGB picture.
    """
    page = Image.new("RGB", (2 * PANEL_PX, PANEL_PX + CHART_PX), "white")
    residuals = (result.residual_a_px, result.residual_b_px)
    top = max(1.0, float(np.ceil(max(np.quantile(residual, 0.98) for residual in residuals))))
    for view, camera in enumerate(cameras):
        page.paste(_overlay(camera, annotations[view], result.curve_mm, images[view]), (view * PANEL_PX, 0))
        mean, most = residuals[view].mean(), np.quantile(residuals[view], 0.95)
        title = f"view {'AB'[view]}: mean {mean:.2f} px, 95 % below {most:.2f} px"
        ImageDraw.Draw(page).text((view * PANEL_PX + 8, 6), title, fill="black" if images[view] is None else "yellow")
        page.paste(_chart(residuals[view], result.length_mm, top), (view * PANEL_PX, PANEL_PX))
    return page


def save_picture(path: str | Path, *args: Any, **kwargs: Any) -> None:
    """Writes `picture` of the same arguments as a PNG, whole or not at all."""
    with whole_file(path, "wb") as file:
        picture(*args, **kwargs).save(file, format="PNG")


def _overlay(camera: Camera, annotation: ArrayLike, curve_mm: Array, image: NDArray[np.uint8] | None) -> Image.Image:
    size = 2 * PANEL_PX  # drawn at twice the size and shrunk: smooth lines
    scale = size / max(camera.width, camera.height)
    if image is None:
        panel = Image.new("RGB", (size, size), (244, 244, 244))
    else:
        panel = (
            Image.fromarray(image).convert("RGB").resize((round(image.shape[1] * scale), round(image.shape[0] * scale)))
        )
        panel = panel.crop((0, 0, size, size))
    draw = ImageDraw.Draw(panel)
    seen = np.asarray(annotation, dtype=float)
    for points, colour, width in ((seen, ANNOTATION, 5), (camera.project(curve_mm), CURVE, 2)):
        draw.line([tuple(point) for point in (points + 0.5) * scale], fill=colour, width=width)
    x, y = (seen[0] + 0.5) * scale
    draw.ellipse((x - 9, y - 9, x + 9, y + 9), outline=(20, 150, 60), width=4)
    return panel.resize((PANEL_PX, PANEL_PX), Image.Resampling.LANCZOS)


def _chart(residual: Array, length_mm: float, top_px: float) -> Image.Image:
    panel = Image.new("RGB", (PANEL_PX, CHART_PX), "white")
    draw = ImageDraw.Draw(panel)
    left, right, upper, lower = 44, PANEL_PX - 14, 14, CHART_PX - 34
    for share in (0.0, 0.5, 1.0):
        y = lower - share * (lower - upper)
        draw.line((left, y, right, y), fill=(220, 220, 220))
        draw.text((8, y - 6), f"{share * top_px:.1f}", fill="black")
        x = left + share * (right - left)
        draw.text((x - 8, lower + 4), f"{share * length_mm:.0f}", fill="black")
    draw.text(((left + right) / 2 - 90, lower + 18), "mm from the tip; reprojection error, px", fill="black")
    across = np.linspace(left, right, len(residual))
    up = lower - np.minimum(residual / top_px, 1.0) * (lower - upper)
    draw.line(list(zip(across.tolist(), up.tolist(), strict=True)), fill=CURVE, width=2)
    return panel
