"""Pictures of a calibration: the holes of a sheet, the displacement of its lattice, a cube's beads and residuals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from guide3d.calibration.cube_calibration import CubeCalibration, CubeView
from guide3d.calibration.perforated_sheet import SheetHoles
from guide3d.geometry.distortion import Distortion
from guide3d.opencv import cv2

Picture = NDArray[np.uint8]  # (h, w, 3) red, green, blue
Colour = tuple[int, int, int]

_GREEN, _RED, _YELLOW, _BLUE, _WHITE = (70, 220, 90), (255, 70, 60), (255, 215, 60), (90, 170, 255), (255, 255, 255)
RESIDUAL_SCALE = 50  # residual arrows are drawn so many times too long
_ENLARGED = 2
_FINE_BITS = 4  # of a pixel's fractions, in which lines and circles are placed
_FINE = 1 << _FINE_BITS


def draw_holes(image: np.ndarray, holes: SheetHoles) -> Picture:
    """The sheet (h, w), twice as large, with every hole marked: whole ones green, those cut by the border red."""
    picture = _ground(image)
    for (x, y), partial in zip(holes.centres_px, holes.partial, strict=True):
        _cross(picture, x, y, 2, _RED if partial else _GREEN)
    _caption(picture, f"{len(holes)} holes, {int(holes.partial.sum())} of them cut by the border")
    return picture


def draw_displacement(holes: SheetHoles, distortion: Distortion) -> Picture:
    """The lattice as the detector sees it (grey) over the lattice undistorted (blue), and some displacements.

    Returns:
        A picture of the raw image's size, enlarged.
    """
    picture = _ground(np.zeros((holes.height, holes.width)))
    number = {tuple(site): k for k, site in enumerate(holes.indices.tolist())}
    for places, colour in ((distortion.ideal_px, (40, 80, 150)), (distortion.raw_px, (150, 150, 150))):
        for (q, r), k in number.items():
            for step in ((1, 0), (0, 1)):
                other = number.get((q + step[0], r + step[1]))
                if other is not None and (q % 3 == 0 if step == (0, 1) else r % 3 == 0):
                    _line(picture, places[k], places[other], colour, 1)
    for k, (q, r) in enumerate(holes.indices):
        if q % 3 == 0 and r % 3 == 0:
            _line(picture, distortion.ideal_px[k], distortion.raw_px[k], _YELLOW, 2)
    far = distortion.displacement_px
    text = f"displacement: mean {far.mean():.1f} px, largest {far.max():.1f} px (blue: undistorted, grey: as seen)"
    _caption(picture, text)
    return picture


def draw_beads(calibration: CubeCalibration, view: CubeView) -> Picture:
    """A cube image, twice as large: beads' numbers (from 1) and residuals, wire marks, beads that were not measured."""
    picture = _ground(view.image)
    key = view.pose, view.detector
    for mark in view.marks:
        for x, y in mark.pixels[::3]:
            _cross(picture, x, y, 1, _BLUE)
        _text(picture, mark.pixels.mean(axis=0) + np.array([10, 14]), mark.kind, _BLUE)
    numbered = np.flatnonzero(view.numbers >= 0)
    residuals, used = calibration.rig.residuals_px.get(key), calibration.rig.used.get(key)
    for order, disc in enumerate(numbered):
        centre, radius = view.beads.centres_px[disc], view.beads.radii_px[disc].mean()
        counted = used is None or bool(used[order])
        _circle(picture, centre, radius + 1.5, _GREEN if counted else _RED)
        _text(picture, centre + np.array([radius + 3, -radius - 9]), str(view.numbers[disc] + 1), _WHITE)
        if residuals is not None:
            _line(picture, centre, centre + RESIDUAL_SCALE * residuals[order], _YELLOW if counted else _RED, 2)
    for disc in np.flatnonzero(view.numbers < 0):
        _circle(picture, view.beads.centres_px[disc], view.beads.radii_px[disc].mean() + 1.5, _RED)
    if view.detector in calibration.rig.cameras and view.pose in calibration.rig.poses and len(view.unseen):
        Q, s = calibration.rig.poses[view.pose]
        places = calibration.rig.cameras[view.detector].project(calibration.points_mm[view.unseen] @ Q.T + s)
        for number, place in zip(
            view.unseen, calibration.distortions[view.detector].distort_points(places), strict=True
        ):
            _circle(picture, place, 12, _BLUE)
            _text(picture, place + np.array([10, 6]), f"{number + 1}?", _BLUE)
    _caption(picture, f"{view.pose}, detector {view.detector}: {len(numbered)} beads, residuals x {RESIDUAL_SCALE}")
    return picture


def _ground(image: np.ndarray) -> Picture:
    top = max(float(np.percentile(image, 99.5)), 1.0)
    grey = np.clip(image * (215 / top), 0, 255).astype(np.uint8)
    large = cv2.resize(grey, None, fx=_ENLARGED, fy=_ENLARGED, interpolation=cv2.INTER_CUBIC)
    return np.repeat(large[:, :, None], 3, axis=2)


def _at(place: np.ndarray) -> tuple[int, int]:
    """A place of the image in sixteenths of the enlarged picture's pixels."""
    x, y = np.rint(_FINE * ((np.asarray(place, float) + 0.5) * _ENLARGED - 0.5)).astype(int)
    return int(x), int(y)  # pixel centres stay pixel centres


def _line(picture: Picture, start: np.ndarray, end: np.ndarray, colour: Colour, width: int) -> None:
    cv2.line(picture, _at(start), _at(end), colour, width, cv2.LINE_AA, _FINE_BITS)


def _cross(picture: Picture, x: float, y: float, size: int, colour: Colour) -> None:
    column, row = (round(value / _FINE) for value in _at(np.array([x, y])))
    cv2.drawMarker(picture, (column, row), colour, cv2.MARKER_CROSS, 2 * size + 1, 1)


def _circle(picture: Picture, centre: np.ndarray, radius: float, colour: Colour) -> None:
    cv2.circle(picture, _at(centre), round(_FINE * radius * _ENLARGED), colour, 2, cv2.LINE_AA, _FINE_BITS)


def _text(picture: Picture, place: np.ndarray, text: str, colour: Colour) -> None:
    column, row = (round(value / _FINE) for value in _at(place))
    _write(picture, (column, row + 16), text, colour, 0.6, 1)


def _caption(picture: Picture, text: str) -> None:
    _write(picture, (16, 42), text, _WHITE, 1.0, 2)


def _write(picture: Picture, place: tuple[int, int], text: str, colour: Colour, size: float, width: int) -> None:
    """Text from its lower left corner, with a black rim."""
    for right, down in ((-2, 0), (2, 0), (0, -2), (0, 2), (0, 0)):
        drawn = (0, 0, 0) if right or down else colour
        at = place[0] + right, place[1] + down
        cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, drawn, width, cv2.LINE_AA)
