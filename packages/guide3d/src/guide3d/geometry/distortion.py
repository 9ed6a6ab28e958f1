"""Image-intensifier distortion: from the raw image to where a flat lattice would have been, and back.

The map stands on the holes of a perforated sheet. Undistorted pixels live in a frame of the same size: the hexagonal
lattice is scaled, turned and shifted to fit all holes by least squares, so that it does not hang on a few border holes.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import RectBivariateSpline

from guide3d.calibration.hexagonal_lattice import lattice_points, local_lattice
from guide3d.calibration.perforated_sheet import SheetHoles
from guide3d.files import whole_file
from guide3d.geometry.displacement_field import NEIGHBOURS, LocalWeightedMean
from guide3d.guarded_reading import open_regular
from guide3d.opencv import cv2
from guide3d.setting_kinds import Numbers, Pixels, settings

# what files say of the fit; the last number has no meaning any more
_FIT: dict[str, Any] = {"method": "local weighted mean", "fit": [NEIGHBOURS, 24]}
FRAMES = ("least squares", "bounding box")
_LARGEST = 64 << 20  # bytes of a map, unpacked too; a sheet has some thousands of holes
_FOLDS = 13  # of q + 3 r: left-out holes are never neighbours
_SHEET_PITCH = 0.0142  # of the image's side, of the holes that stand for a known distortion
_GRID_PX = 8  # images are mapped through a grid this fine; between, the map is smooth


def ideal_lattice(holes: SheetHoles, frame: str = "least squares") -> np.ndarray:
    """Where the holes would be without distortion, (n, 2) undistorted px.

    Args:
        frame: "least squares": scale, angle and shift that fit all holes best. "bounding box": turned as the lattice in
            the middle of the image, then scaled along x and along y to the box around the holes, as XMALab does it;
            needed only to go with projections that were calibrated there.

    Raises:
        ValueError: There is no such frame.
    """
    places, seen = lattice_points(holes.indices), holes.centres_px
    if frame == "least squares":
        mean = places.mean(axis=0)
        a = (places - mean) @ np.array([1, 1j])  # a similarity is a complex factor
        b = (seen - seen.mean(axis=0)) @ np.array([1, 1j])
        turned = a * (np.vdot(a, b) / np.vdot(a, a))
        return np.column_stack([turned.real, turned.imag]) + seen.mean(axis=0)
    if frame == "bounding box":
        middle = int(np.argmin(np.linalg.norm(seen - (np.array([holes.width, holes.height]) - 1) / 2, axis=1)))
        a, b, c, d = local_lattice(seen, holes.indices, holes.indices[middle : middle + 1])[0].ravel()
        angle = np.arctan2(c - b, a + d)  # of the rotation nearest to the local lattice
        places = places @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        low, high = seen.min(axis=0), seen.max(axis=0)
        return low + (places - places.min(axis=0)) / np.ptp(places, axis=0) * (high - low)
    raise ValueError(f"expected a frame among {', '.join(FRAMES)}, found {frame!r}")


@settings(eq=False)
class Distortion:
    """The map of one detector at one time.

    raw_px: (n, 2) control points in the raw image
    ideal_px: (n, 2) the same, undistorted
    """

    raw_px: Numbers
    ideal_px: Numbers
    width: Pixels
    height: Pixels

    def __post_init__(self) -> None:
        if (
            np.ndim(self.raw_px) != 2
            or np.shape(self.raw_px) != np.shape(self.ideal_px)
            or np.shape(self.raw_px)[1] != 2
        ):
            raise ValueError(
                f"expected control points (n, 2) twice, found {np.shape(self.raw_px)} and {np.shape(self.ideal_px)}"
            )
        if not np.isfinite(self.raw_px).all() or not np.isfinite(self.ideal_px).all():
            raise ValueError("control points must be finite: leave out what was not found")

    @classmethod
    def from_holes(cls, holes: SheetHoles, frame: str = "least squares") -> Distortion:
        """The map of a sheet's holes; `frame` is that of `ideal_lattice`."""
        return cls(holes.centres_px, ideal_lattice(holes, frame), holes.width, holes.height)

    @classmethod
    def of_function(cls, distort: Callable[[np.ndarray], np.ndarray], size_px: int) -> Distortion:
        """Samples a known distortion as a perforated sheet in front of the detector would show it, without error.

        Args:
            distort: takes undistorted px (n, 2) to raw ones.
        """
        pitch, reach, middle = _SHEET_PITCH * size_px, int(1.2 / _SHEET_PITCH), (size_px - 1) / 2
        q, r = (index.ravel() for index in np.mgrid[-reach : reach + 1, -reach : reach + 1])
        ideal = pitch * lattice_points(np.column_stack([q, r])) + middle
        raw = np.full_like(ideal, np.inf)
        near = np.abs(ideal - middle).max(axis=1) < 0.6 * size_px
        raw[near] = distort(ideal[near])
        inside = (np.abs(raw - middle) <= size_px / 2 + pitch).all(axis=1)
        return cls(raw[inside], ideal[inside], size_px, size_px)

    @cached_property
    def _forward(self) -> LocalWeightedMean:
        return LocalWeightedMean(self.raw_px, self.ideal_px)

    @cached_property
    def _backward(self) -> LocalWeightedMean:
        return LocalWeightedMean(self.ideal_px, self.raw_px)

    @property
    def displacement_px(self) -> np.ndarray:
        """How far each control point lies from where it should, (n,) px."""
        return np.asarray(np.linalg.norm(self.raw_px - self.ideal_px, axis=1))

    def undistort_points(self, raw_points: np.ndarray) -> np.ndarray:
        """Raw pixels (..., 2) to undistorted ones; beyond the holes an almost linear continuation.

        Raises:
            ValueError: The points are not two-dimensional.
        """
        return self._forward(_checked(raw_points))

    def distort_points(self, points: np.ndarray) -> np.ndarray:
        """Undistorted pixels (..., 2) to raw ones (..., 2): the inverse of `undistort_points`, to 1e-6 px."""
        points = _checked(points)
        raw = self._backward(points)
        # the two fits miss each other by hundredths of a pixel; the map is near enough to a shift for plain iteration
        missing = points - self._forward(raw)
        for _ in range(12):
            trial = raw + missing
            remainder = points - self._forward(trial)
            better = (np.abs(remainder).max(axis=-1) < np.abs(missing).max(axis=-1))[..., None]
            raw, missing = np.where(better, trial, raw), np.where(better, remainder, missing)
            if not better.any() or np.abs(missing).max() < 1e-7:
                break
        return raw

    @cached_property
    def _sources(self) -> tuple[np.ndarray, np.ndarray]:
        """Where each undistorted pixel comes from: columns and rows of the raw image, (h, w) float32 each."""
        x = np.arange(-_GRID_PX, self.width + 2 * _GRID_PX, _GRID_PX)
        y = np.arange(-_GRID_PX, self.height + 2 * _GRID_PX, _GRID_PX)
        coarse = self._backward(np.stack(np.meshgrid(x, y), axis=-1).astype(float))
        # Cubic splines interpolate here, which OpenCV does not have.
        along = np.arange(self.height), np.arange(self.width)
        columns, rows = (RectBivariateSpline(y, x, coarse[..., axis])(*along) for axis in (0, 1))
        return columns.astype(np.float32), rows.astype(np.float32)

    def undistort_image(self, image: np.ndarray, fill: float = 0.0) -> np.ndarray:
        """The image as an undistorted detector would have taken it, of the same shape and type.

        Args:
            image: (height, width) or (height, width, channels), raw.
            fill: Grey value of what lies outside the raw image.

        Raises:
            ValueError: The image has another size than the sheet's.
        """
        image = np.asarray(image)
        if image.shape[:2] != (self.height, self.width) or image.ndim not in (2, 3):
            size = " x ".join(str(side) for side in image.shape[1::-1])
            raise ValueError(f"expected an image of {self.width} x {self.height} px, as the sheet's, found {size}")
        # OpenCV rounds places to 1/32 px in images of other types, float64 among them.
        known = image.dtype in (np.uint8, np.uint16, np.float32)
        channels = image.shape[2] if image.ndim == 3 else 1
        values = cv2.remap(
            image if known else image.astype(np.float32),
            *self._sources,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=channels * (fill,),
        ).reshape(image.shape)
        if np.issubdtype(image.dtype, np.integer) and not known:
            limits = np.iinfo(image.dtype)
            values = np.clip(np.rint(values).astype(float), limits.min, limits.max)
        return values.astype(image.dtype)

    def swirled(self, shift_px: float) -> Distortion:
        """This map followed by a swirl of `shift_px` at the border, as `guide3d.calibration.rig` estimates it."""
        ideal = self.ideal_px + shift_px * swirl_pattern(self.ideal_px, self.width, self.height)
        return replace(self, ideal_px=ideal)

    def save(self, path: str | Path) -> None:
        """Write the map to a .npz file, whole or not at all."""
        with whole_file(path) as file:
            np.savez_compressed(
                file,
                kind="guide3d distortion 1",
                raw_px=self.raw_px,
                ideal_px=self.ideal_px,
                size=[self.width, self.height],
                **_FIT,
            )

    @classmethod
    def load(cls, path: str | Path) -> Distortion:
        """Read a map that `save` wrote.

        Raises:
            FileNotFoundError: There is no such file.
            ValueError: The file holds something else.
        """
        path = Path(path)
        if not path.exists():
            raise FileNotFoundError(f"distortion file {path} is missing")
        try:
            parts = _parts(path)
            width, height = (int(side) for side in parts["size"])
            method, neighbours = str(parts["method"]), int(parts["fit"][0])
            if (method, neighbours) != (_FIT["method"], NEIGHBOURS):
                raise ValueError(f"the method {method} of {neighbours} neighbours: make the map again")
            return cls(parts["raw_px"], parts["ideal_px"], width, height)
        except Exception as error:  # a damaged archive raises a dozen kinds
            raise ValueError(f"{path}: expected a map as Distortion.save writes it, found {error}") from None


def _parts(path: Path) -> dict[str, np.ndarray]:
    with open_regular(path, _LARGEST) as file:
        with zipfile.ZipFile(file) as archive:
            if sum(part.file_size for part in archive.infolist()) > _LARGEST:
                raise ValueError("more points than any sheet has holes")
        file.seek(0)
        with np.load(file, allow_pickle=False) as data:
            return {name: data[name] for name in ("size", "fit", "raw_px", "ideal_px", "method")}


def leave_out_errors(holes: SheetHoles) -> np.ndarray:
    """How far (n,) px `Distortion.from_holes` puts holes that it was not fitted to from where they should be.

    A thirteenth of the holes at a time, no two of them near each other; in the undistorted frame.
    """
    raw, ideal = holes.centres_px, ideal_lattice(holes)
    fold = (holes.indices[:, 0] + 3 * holes.indices[:, 1]) % _FOLDS
    errors = np.zeros(len(holes))
    for number in range(_FOLDS):
        out = fold == number
        field = LocalWeightedMean(raw[~out], ideal[~out])
        errors[out] = np.linalg.norm(field(raw[out]) - ideal[out], axis=1)
    return errors


def swirl_pattern(pixels: np.ndarray, width: int, height: int) -> np.ndarray:
    """Shift (..., 2) px of undistorted pixels (..., 2) of an image by a swirl of one pixel.

    The part of an image intensifier's distortion that turns the image more the farther from its middle; it follows the
    magnetic field, so it need not be the same when the cube is imaged as when the sheet was. Its length is one at half
    the longer side from the middle, and grows with the cube of the distance.
    """
    half = max(width, height) / 2
    away = (np.asarray(pixels, float) - (np.array([width, height]) - 1) / 2) / half
    return np.stack([-away[..., 1], away[..., 0]], axis=-1) * (away**2).sum(axis=-1, keepdims=True)


def _checked(points: np.ndarray) -> np.ndarray:
    points = np.asarray(points, float)
    if points.shape[-1:] != (2,):
        raise ValueError(f"expected pixels of shape (..., 2), found {points.shape}")
    return points
