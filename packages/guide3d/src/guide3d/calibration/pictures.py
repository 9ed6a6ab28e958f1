"""Pictures of a calibration: the holes of a sheet, the displacement of its lattice, a cube's beads and residuals."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from guide3d.calibration.cube_calibration import CubeCalibration, CubeView
from guide3d.calibration.perforated_sheet import SheetHoles
from guide3d.geometry.distortion import Distortion

_GREEN, _RED, _YELLOW, _BLUE, _WHITE = (70, 220, 90), (255, 70, 60), (255, 215, 60), (90, 170, 255), (255, 255, 255)
RESIDUAL_SCALE = 50  # residual arrows are drawn so many times too long
_ENLARGED = 2


def draw_holes(image: np.ndarray, holes: SheetHoles) -> Image.Image:
    """The sheet (h, w), twice as large, with every hole marked: whole ones green, those cut by the border red."""
    picture, draw = _ground(image, _ENLARGED)
    for (x, y), partial in zip(holes.centres_px, holes.partial, strict=True):
        _cross(draw, x, y, 2, _RED if partial else _GREEN)
    _caption(draw, f"{len(holes)} holes, {int(holes.partial.sum())} of them cut by the border")
    return picture


def draw_displacement(holes: SheetHoles, distortion: Distortion) -> Image.Image:
    """The lattice as the detector sees it (grey) over the lattice undistorted (blue), and some displacements.

    Returns:
        A picture of the raw image's size, enlarged.
    """
    picture, draw = _ground(np.zeros((holes.height, holes.width)), _ENLARGED)
    number = {tuple(site): k for k, site in enumerate(holes.indices.tolist())}
    for places, colour in ((distortion.ideal_px, (40, 80, 150)), (distortion.raw_px, (150, 150, 150))):
        for (q, r), k in number.items():
            for step in ((1, 0), (0, 1)):
                other = number.get((q + step[0], r + step[1]))
                if other is not None and (q % 3 == 0 if step == (0, 1) else r % 3 == 0):
                    _line(draw, places[k], places[other], colour, 1)
    for k, (q, r) in enumerate(holes.indices):
        if q % 3 == 0 and r % 3 == 0:
            _line(draw, distortion.ideal_px[k], distortion.raw_px[k], _YELLOW, 2)
    far = distortion.displacement_px
    text = f"displacement: mean {far.mean():.1f} px, largest {far.max():.1f} px (blue: undistorted, grey: as seen)"
    _caption(draw, text)
    return picture


def draw_beads(calibration: CubeCalibration, view: CubeView) -> Image.Image:
    """A cube image, twice as large: beads' numbers (from 1) and residuals, wire marks, beads that were not measured."""
    picture, draw = _ground(view.image, _ENLARGED)
    key = view.pose, view.detector
    for mark in view.marks:
        for x, y in mark.pixels[::3]:
            _cross(draw, x, y, 1, _BLUE)
        _text(draw, mark.pixels.mean(axis=0) + np.array([10, 14]), mark.kind, _BLUE)
    numbered = np.flatnonzero(view.numbers >= 0)
    residuals, used = calibration.rig.residuals_px.get(key), calibration.rig.used.get(key)
    for order, disc in enumerate(numbered):
        centre, radius = view.beads.centres_px[disc], view.beads.radii_px[disc].mean()
        counted = used is None or bool(used[order])
        _circle(draw, centre, radius + 1.5, _GREEN if counted else _RED)
        _text(draw, centre + np.array([radius + 3, -radius - 9]), str(view.numbers[disc] + 1), _WHITE)
        if residuals is not None:
            _line(draw, centre, centre + RESIDUAL_SCALE * residuals[order], _YELLOW if counted else _RED, 2)
    for disc in np.flatnonzero(view.numbers < 0):
        _circle(draw, view.beads.centres_px[disc], view.beads.radii_px[disc].mean() + 1.5, _RED)
    if view.detector in calibration.rig.cameras and view.pose in calibration.rig.poses and len(view.unseen):
        Q, s = calibration.rig.poses[view.pose]
        places = calibration.rig.cameras[view.detector].project(calibration.points_mm[view.unseen] @ Q.T + s)
        for number, place in zip(
            view.unseen, calibration.distortions[view.detector].distort_points(places), strict=True
        ):
            _circle(draw, place, 12, _BLUE)
            _text(draw, place + np.array([10, 6]), f"{number + 1}?", _BLUE)
    _caption(draw, f"{view.pose}, detector {view.detector}: {len(numbered)} beads, residuals x {RESIDUAL_SCALE}")
    return picture


def _ground(image: np.ndarray, enlarged: int) -> tuple[Image.Image, ImageDraw.ImageDraw]:
    top = max(float(np.percentile(image, 99.5)), 1.0)
    grey = Image.fromarray(np.clip(image * (215 / top), 0, 255).astype(np.uint8))
    picture = grey.convert("RGB").resize(
        (image.shape[1] * enlarged, image.shape[0] * enlarged), Image.Resampling.BICUBIC
    )
    return picture, ImageDraw.Draw(picture)


def _at(place: np.ndarray) -> tuple[float, float]:
    x, y = (np.asarray(place, float) + 0.5) * _ENLARGED - 0.5  # pixel centres stay pixel centres
    return float(x), float(y)


def _line(
    draw: ImageDraw.ImageDraw, start: np.ndarray, end: np.ndarray, colour: tuple[int, int, int], width: int
) -> None:
    draw.line([_at(start), _at(end)], fill=colour, width=width)


def _cross(draw: ImageDraw.ImageDraw, x: float, y: float, size: int, colour: tuple[int, int, int]) -> None:
    column, row = _at(np.array([x, y]))
    draw.line([(column - size, row), (column + size, row)], fill=colour)
    draw.line([(column, row - size), (column, row + size)], fill=colour)


def _circle(draw: ImageDraw.ImageDraw, centre: np.ndarray, radius: float, colour: tuple[int, int, int]) -> None:
    (x, y), r = _at(centre), radius * _ENLARGED
    draw.ellipse([x - r, y - r, x + r, y + r], outline=colour, width=2)


def _text(draw: ImageDraw.ImageDraw, place: np.ndarray, text: str, colour: tuple[int, int, int]) -> None:
    draw.text(_at(place), text, fill=colour, font=ImageFont.load_default(18), stroke_width=2, stroke_fill=(0, 0, 0))


def _caption(draw: ImageDraw.ImageDraw, text: str) -> None:
    draw.text((16, 12), text, fill=_WHITE, font=ImageFont.load_default(30), stroke_width=3, stroke_fill=(0, 0, 0))
