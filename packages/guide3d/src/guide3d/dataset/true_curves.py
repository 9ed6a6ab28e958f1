"""Simulated wires: their truth in space (truth.json, beside the files of the public layout) and their annotation."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from guide3d.files import read_json, whole_file
from guide3d.geometry.bspline import BSplineCurve, fit_bspline
from guide3d.geometry.polyline import Array, arc_length, at_length, checked, resample

VIEWS = ("a", "b")
SPACING_PX, TURNING = 8.0, 0.2  # rad, of an exact annotation: within 0.05 px of the wire
CLICKS_PX = (15.0, 30.0)  # between the clicks of a person on a straight stretch
TURN_PX = 30.0  # a turn of 1 rad asks for clicks like so much more length
_DENSE_PX = 1.0  # of the polyline that clicks on an annotation are drawn from
_SPLINE_PX = 0.05  # a fitted curve keeps this near to exact annotations, and to clicks as near as their noise


@dataclass(frozen=True, eq=False)
class TrueCurve:
    """A simulated wire.

    Attributes:
        points_mm: (n, 3) world, tip first, up to where the wire has left both images.
        visible_mm: arc length from the tip to where the wire first leaves the image, of camera "a" and "b".
    """

    points_mm: Array
    visible_mm: tuple[float, float]


def read_truth(path: Path, damaged: list[str]) -> dict[tuple[str, int], TrueCurve]:
    """Reads truth.json: (acquisition, frame number) to the wire.

    Args:
        damaged: takes a sentence for every entry that is left out.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is something else.
    """
    content = read_json(path, "file of true curves")
    if not isinstance(content, Mapping) or content.get("unit") != "mm" or not isinstance(content.get("frames"), list):
        raise ValueError(f'{path}: expected an object with "unit": "mm" and a list "frames"')
    curves = {}
    for place, entry in enumerate(content["frames"]):
        try:
            points = checked(entry["points"], 3, "true curve")
            a, b = (float(entry["visible_mm"][view]) for view in VIEWS)
            curves[str(entry["acquisition"]), int(entry["frame_number"])] = TrueCurve(points, (a, b))
        except KeyError as error:
            damaged.append(f"{path.name}, entry {place}: {error} is missing")
        except (TypeError, ValueError, OverflowError) as error:
            damaged.append(f"{path.name}, entry {place}: {error}")
    return curves


def write_truth(path: Path, curves: Mapping[tuple[str, int], TrueCurve]) -> None:
    """Writes truth.json, whole or not at all, of (acquisition, frame number) to the wire."""
    frames = [
        {
            "acquisition": acquisition,
            "frame_number": number,
            "visible_mm": {view: round(float(end), 4) for view, end in zip(VIEWS, curve.visible_mm, strict=True)},
            "points": np.round(curve.points_mm, 4).tolist(),
        }
        for (acquisition, number), curve in curves.items()
    ]
    with whole_file(path, "w") as file:
        json.dump({"unit": "mm", "frames": frames}, file, separators=(",", ":"), allow_nan=False)
        file.write("\n")


@dataclass(frozen=True, eq=False)
class VisiblePart:
    """A wire as one camera sees it.

    Attributes:
        points: (n, 2) px, tip first, to where the wire leaves the image.
        length: arc length from the tip to there, in the unit of the curve.
    """

    points: Array
    length: float


def visible_part(pixels: Array, arc: Array, size_px: int) -> VisiblePart | None:
    """Cuts a projected curve where it first leaves the image.

    Args:
        pixels: (n, 2) px, of the curve from the tip.
        arc: (n,) arc length in space.

    Returns:
        The part in view; None where the tip is not.
    """
    beyond = np.maximum(-pixels, pixels - (size_px - 1)).max(axis=1)
    outside = np.flatnonzero(beyond > 0)
    if not len(outside):
        return VisiblePart(pixels, float(arc[-1]))
    end = int(outside[0])
    if end == 0:
        return None
    share = -beyond[end - 1] / (beyond[end] - beyond[end - 1])  # of the last short, straight piece
    last = pixels[end - 1] + share * (pixels[end] - pixels[end - 1])
    length = arc[end - 1] + share * (arc[end] - arc[end - 1])
    return VisiblePart(np.vstack([pixels[:end], last]), float(length))


def annotate(points: Array, noise_px: float, size_px: int, generator: np.random.Generator) -> Array:
    """Draws the polyline that an annotator leaves.

    Args:
        points: (n, 2) px, the wire in view, dense.
        noise_px: standard deviation of a click in each direction; 0 gives the exact, dense polyline.

    Returns:
        (m, 2) px, both ends of the wire among them.
    """
    if noise_px == 0:
        return thin_by_turning(points, SPACING_PX, TURNING)
    along = arc_length(points)
    measure = along + TURN_PX * _turned(points)
    places = np.cumsum(generator.uniform(*CLICKS_PX, int(measure[-1] / CLICKS_PX[0]) + 1))
    inner = places[places < measure[-1] - CLICKS_PX[0] / 2]
    clicks = at_length(points, np.interp([0.0, *inner, measure[-1]], measure, along))
    return np.clip(clicks + noise_px * generator.standard_normal(clicks.shape), 0.0, size_px - 1.0)


def click(polyline: Array, noise_px: float, size_px: int, generator: np.random.Generator) -> Array:
    """Annotates an annotated polyline (n, 2) px once more, by noisy clicks; arguments as of `annotate`."""
    dense = resample(polyline, count=max(2, int(arc_length(polyline)[-1] / _DENSE_PX)))
    return annotate(dense, noise_px, size_px, generator)


def fit_annotation(points: Array, noise_px: float) -> BSplineCurve:
    """Fits the smooth curve of b_spline.json to an annotation (n, 2) px with clicks of this noise."""
    return fit_bspline(points, smoothing=2 * max(noise_px, _SPLINE_PX) ** 2 * len(points))


def thin_by_turning(points: Array, spacing: float, turning: float) -> Array:
    """Thins a dense curve, less where it turns, so that no chord strays far from it.

    Args:
        points: (n, d) dense.
        spacing: longest distance of neighbours on a straight stretch, in the unit of the points.
        turning: largest turn between neighbours, rad. A chord strays by at most spacing x turning / 32.

    Returns:
        (m, d) of the points, both ends among them.
    """
    measure = arc_length(points) / spacing + _turned(points) / turning
    count = max(2, int(np.ceil(measure[-1])) + 1)
    rows = np.searchsorted(measure, np.linspace(0.0, measure[-1], count)).clip(0, len(points) - 1)
    return points[np.unique(np.concatenate([[0], rows, [len(points) - 1]]))]


def _turned(points: Array) -> Array:
    """Returns how far a dense curve has turned up to each of its points, rad, whichever way. Shape (n,)."""
    steps = np.diff(points, axis=0)
    steps = steps / np.maximum(np.linalg.norm(steps, axis=1, keepdims=True), 1e-12)
    bends = 2 * np.arcsin(np.minimum(np.linalg.norm(np.diff(steps, axis=0), axis=1) / 2, 1.0))
    return np.concatenate([[0.0], np.cumsum(bends), [bends.sum()]])
