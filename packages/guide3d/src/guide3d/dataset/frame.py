"""One moment of the data set: both images, their annotation, and the wire in space where it is known."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from guide3d.dataset.annotation_files import Annotation, Views
from guide3d.dataset.true_curves import VIEWS, TrueCurve
from guide3d.geometry.bspline import BSplineCurve, fit_bspline
from guide3d.geometry.polyline import Array, arc_length, at_length, checked, resample
from guide3d.image_file import GreyLevels, ImageError, read_grey_levels

_PIECE_PX = 32.0  # longer pieces are cut, so that the window around each stays small


Item = TypeVar("Item")
TRUTH_SPACING_MM = 0.5
SPLINE_SMOOTHING_PX = 0.7  # root mean square distance that a fitted curve may leave to the clicks


def strip_mask(points: ArrayLike, width: int, height: int, width_px: float = 6.0) -> NDArray[np.uint8]:
    """The mask of a wire along a polyline (n, 2) px, with round ends: (height, width) uint8, 255 on the wire, else 0.

    A pixel belongs to the mask where the strip covers half of it, which is where its centre lies within half the width
    of the polyline: the threshold at 128 of an anti-aliased drawing.

    Raises:
        ValueError: points that are no polyline, or a width that is not above 0.
    """
    if not width_px > 0:
        raise ValueError(f"width_px: expected above 0, got {width_px}")
    line = checked(points, 2)
    reach = max(width_px / 2, 0.5)  # a thinner strip would have gaps
    near = np.zeros((height, width), bool)
    starts, ends = _cut(line)
    low = np.floor(np.minimum(starts, ends) - reach).astype(int)
    high = np.ceil(np.maximum(starts, ends) + reach).astype(int)
    low, high = np.maximum(low, 0), np.minimum(high, [width - 1, height - 1])
    for start, end, (left, top), (right, bottom) in zip(starts, ends, low, high, strict=True):
        if left > right or top > bottom:
            continue
        x = np.arange(left, right + 1) - start[0]
        y = np.arange(top, bottom + 1)[:, None] - start[1]
        step = end - start
        along = np.clip((x * step[0] + y * step[1]) / max(float(step @ step), 1e-12), 0.0, 1.0)
        distance2 = np.square(x - along * step[0]) + np.square(y - along * step[1])
        near[top : bottom + 1, left : right + 1] |= distance2 <= reach * reach
    return np.where(near, 255, 0).astype(np.uint8)


def _cut(line: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Starts and ends of pieces of at most `_PIECE_PX`."""
    steps = np.diff(line, axis=0)
    pieces = np.maximum(np.ceil(np.linalg.norm(steps, axis=1) / _PIECE_PX).astype(int), 1)
    segment = np.repeat(np.arange(len(steps)), pieces)
    part = np.arange(len(segment)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    starts = line[segment] + (part / pieces[segment])[:, None] * steps[segment]
    ends = line[segment] + ((part + 1) / pieces[segment])[:, None] * steps[segment]
    return starts, ends


def read_image(path: Path, size_px: tuple[int, int] | None = None) -> NDArray[np.uint8]:
    """Reads a grey image, (height, width) uint8.

    Args:
        path: PNG or JPEG; of deeper images the upper 8 bits count.
        size_px: width and height that it must have; any where None.

    Raises:
        ImageError: it is missing, cannot be read, or has another size.
    """
    try:
        pixels = eight_bits(read_grey_levels(path))
    except ImageError as error:
        raise ImageError(str(error) if path.name in str(error) else f"image {path}: {error}") from None
    if size_px is not None and pixels.shape != (size_px[1], size_px[0]):
        raise ImageError(
            f"image {path}: expected {size_px[0]} x {size_px[1]} px, got {pixels.shape[1]} x {pixels.shape[0]}; "
            "annotation and cameras belong to the other size"
        )
    return pixels


@dataclass(frozen=True, eq=False)
class Frame:
    """Both views of one moment; images are read when they are asked for.

    Attributes:
        annotation: acquisition, number, wire, fluid, and the polylines.
        images: folder of the images; None where the data set has none.
        size_px: camera "a" and "b" to width and height of its images.
        views: fitted curves that came with the data set.
    """

    annotation: Annotation
    images: Path | None
    size_px: dict[str, tuple[int, int]]
    views: Views | None = None
    truth: TrueCurve | None = None

    @property
    def acquisition(self) -> str:
        """Name of the video, e.g. "1-bca-angle-5"."""
        return self.annotation.acquisition

    @property
    def number(self) -> int:
        """Of the frame in its video."""
        return self.annotation.number

    @property
    def label(self) -> str:
        """The frame's name in messages, e.g. "1-bca-angle-5/012"."""
        return self.annotation.label

    @property
    def fluid(self) -> bool:
        """Whether the phantom was filled."""
        return self.annotation.fluid

    @property
    def wire(self) -> str:
        """The kind of wire, "angled" or "straight"."""
        return self.annotation.wire

    def image_path(self, camera: str) -> Path | None:
        """Where the image of camera "a" or "b" lies; None where the data set has no images."""
        name = self._of(camera, self.annotation.image_a, self.annotation.image_b)
        return None if self.images is None else self.images / name

    def image(self, camera: str) -> NDArray[np.uint8]:
        """The image of camera "a" or "b", (height, width) uint8.

        Raises:
            ImageError: it is missing, damaged or of another size.
        """
        path = self.image_path(camera)
        if path is None:
            raise ImageError(f"frame {self.label} has no image: the data set consists of annotations only")
        return read_image(path, self.size_px[camera])

    def polyline(self, camera: str) -> Array:
        """The annotation of camera "a" or "b": (n, 2) px, tip first."""
        return self._of(camera, self.annotation.points_a, self.annotation.points_b)

    def spline(self, camera: str) -> BSplineCurve:
        """The fitted curve of camera "a" or "b", px: that of the data set, or else one fitted to the polyline."""
        if self.views is not None:
            return self._of(camera, self.views.a, self.views.b)
        points = self.polyline(camera)
        return fit_bspline(points, smoothing=SPLINE_SMOOTHING_PX**2 * len(points), what=f"frame {self.label}")

    def mask(self, camera: str, width_px: float = 6.0) -> NDArray[np.uint8]:
        """The wire's mask along the annotation of camera "a" or "b": (height, width) uint8, 255 on the wire."""
        width, height = self.size_px[camera]
        return strip_mask(self.polyline(camera), width, height, width_px)

    @property
    def curve_mm(self) -> Array | None:
        """(n, 3) the true wire from the tip to where it first leaves one of the images; None for real images."""
        return None if self.truth is None else self.visible_curve_mm(*VIEWS)

    def visible_curve_mm(self, *cameras: str) -> Array | None:
        """The true wire from the tip to where it first leaves the image of one of some cameras ("a", "b" or both).

        Returns:
            (n, 3) world, mm, a point every 0.5 mm; None for real images.
        """
        if self.truth is None:
            return None
        points = self.truth.points_mm
        length = arc_length(points)[-1]
        end = min(length, *(self._of(camera, *self.truth.visible_mm) for camera in cameras))
        return at_length(points, np.append(np.arange(0.0, end - 1e-6, TRUTH_SPACING_MM), end))

    @property
    def reconstruction_mm(self) -> Array | None:
        """(n, 3) the curve in space that came with the data set, mm, a point a millimetre; None without one."""
        if self.views is None or self.views.space is None:
            return None
        return resample(self.views.space.sample(1000), spacing=1.0)

    def _of(self, camera: str, a: Item, b: Item) -> Item:
        if camera not in VIEWS:
            raise ValueError(f"expected camera 'a' or 'b', got {camera!r}")
        return a if camera == "a" else b


def eight_bits(levels: GreyLevels) -> NDArray[np.uint8]:
    """Grey levels as uint8: integers by their upper eight bits, real numbers as parts of 1, 255 or 65535.

    Raises:
        ImageError: real numbers beyond that, or 12 bits in 16, which would be black.
    """
    if levels.dtype == np.uint8:
        return levels.astype(np.uint8)
    if levels.dtype == np.uint16:
        if 0 < (highest := int(levels.max())) < 1 << 12:
            raise ImageError(f"its 16-bit values end at {highest} of 65535: scale them to 16 bits, or save 8 bits")
        return (levels // 256).astype(np.uint8)
    low, high = float(levels.min()), float(levels.max())
    top = next((top for top in (1.0, 255.0, 65535.0) if high <= top), 0.0)
    if low < 0 or not top:
        raise ImageError(f"expected grey values from 0 to 1, 255 or 65535, found {low:g} to {high:g}")
    return np.rint(levels * (255.0 / top)).astype(np.uint8)
