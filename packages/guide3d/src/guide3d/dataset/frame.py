"""One moment of the data set: both images, their annotation, and the wire in space where it is known."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from guide3d.dataset.annotation_files import Annotation, Views
from guide3d.dataset.masks import strip_mask
from guide3d.dataset.true_curves import VIEWS, TrueCurve
from guide3d.geometry.bspline import BSplineCurve, fit_bspline
from guide3d.geometry.polyline import Array, arc_length, at_length, resample
from guide3d.image_file import ImageError, eight_bits, read_grey_levels

Item = TypeVar("Item")

TRUTH_SPACING_MM = 0.5
SPLINE_SMOOTHING_PX = 0.7  # root mean square distance that a fitted curve may leave to the clicks


def read_image(path: Path, size_px: tuple[int, int] | None = None) -> NDArray[np.uint8]:
    """Reads a grey image, (height, width) uint8.

    Args:
        path: PNG or JPEG; of deeper images the upper 8 bits count.
        size_px: width and height that it must have; any where None.

    Raises:
        ImageError: it is missing, cannot be read, or has another size.
    """
    pixels = eight_bits(read_grey_levels(path))
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
