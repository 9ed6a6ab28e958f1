"""The wire in a fluoroscopic image: a smooth anti-aliased curve over a finished background, and its mask."""

from __future__ import annotations

import ctypes
import functools
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cathsim.fluoroscopy.attenuation import GAMMA
from cathsim.fluoroscopy.projector import Projector
from cathsim.presets import WIRE_RADIUS

WIRE_ATTENUATION = 3500.0  # 1/m: nitinol (about 760) under a radiopaque jacket and coil
MINIMUM_WIDTH_PX = 1.2
MASK_REACH_PX = 0.7072  # half a pixel's diagonal: every pixel that the axis enters is in the mask, without a gap
ENTRIES = 1024

FAILURES = {
    1: "a coordinate of the wire is not finite; the simulation has diverged, reset it.",
    2: "a point of the wire lies behind the X-ray source; move the camera back.",
}


class ViewStruct(ctypes.Structure):
    """struct FluoroscopyView of fluoroscopy.c."""

    _fields_ = (
        ("width", ctypes.c_int),
        ("height", ctypes.c_int),
        ("projection", ctypes.c_double * 12),
        ("background", ctypes.c_void_p),
        ("transmission", ctypes.c_void_p),
        ("entries", ctypes.c_int),
        ("shadow_reach", ctypes.c_float),
        ("mask_reach", ctypes.c_float),
        ("piece", ctypes.c_double),
        ("nearest", ctypes.c_void_p),
    )


class FluoroscopyRenderer:
    """Draws a wire over one camera's background; deterministic, and safe to share between threads.

    The wire is a smooth curve through its nodes. It attenuates as a cylinder does, averaged over each pixel; where the
    image is too coarse for it, it is drawn 1.2 px wide so that it does not vanish. Its width is that at the image's
    centre: perspective would change it by some per cent over a phantom.

    Args:
        background: (height, width) grey levels 0 to 255 without the wire, as `background_image` makes them.
        wire_radius: m.
        centre: (3,) m, where the wire's width is taken; the middle of the phantom.

    Raises:
        ValueError: when the background does not fit the camera or the wire's radius is not positive.
    """

    def __init__(
        self,
        projector: Projector,
        background: ArrayLike,
        *,
        wire_radius: float = WIRE_RADIUS,
        centre: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        grey = np.ascontiguousarray(background, dtype=np.float32)
        shape = (projector.height, projector.width)
        if grey.shape != shape:
            raise ValueError(f"the background must have the camera's shape {shape}, got {grey.shape}.")
        if not (np.isfinite(grey).all() and grey.min() >= 0 and grey.max() <= 255):
            raise ValueError("the background's grey levels must lie between 0 and 255; pass it through expose().")
        if not wire_radius > 0:
            raise ValueError(f"wire_radius must be positive, got {wire_radius!r} m.")
        self._arguments = (projector, grey)
        self._options: dict[str, Any] = {"wire_radius": wire_radius, "centre": centre}
        self.projector = projector
        self.shape = shape
        self._grey = grey
        self._empty = np.rint(grey).astype(np.uint8)
        self._empty.flags.writeable = False
        radius = max(wire_radius * projector.pixels_per_metre(centre), MINIMUM_WIDTH_PX / 2)
        self.wire_width_px = 2 * radius
        self._transmission = _transmission(radius, GAMMA * WIRE_ATTENUATION * 2 * wire_radius)
        self._view = view_struct(projector, grey, self._transmission, radius)
        self._address = ctypes.addressof(self._view)
        self._draw = native_draw()

    def __reduce__(self) -> tuple[Any, ...]:
        return functools.partial(type(self), **self._options), self._arguments  # native structs are made again

    def __deepcopy__(self, memo: dict[int, object]) -> FluoroscopyRenderer:
        return self  # never changes

    @property
    def background(self) -> NDArray[np.uint8]:
        """(height, width) uint8, the image without a wire, read-only."""
        return self._empty

    def render(self, points: ArrayLike) -> NDArray[np.uint8]:
        """Image (height, width) uint8 of the wire, a new array.

        Args:
            points: (n, 3) m, the wire's nodes in order, world frame; only the part outside the sheath.

        Raises:
            ValueError: for points of another shape, not finite, or behind the source.
        """
        image = np.empty(self.shape, np.uint8)
        self.render_into(points, image, None)
        return image

    def mask(self, points: ArrayLike) -> NDArray[np.uint8]:
        """Pixels that show the wire's nodes (n, 3) m: (height, width) uint8, 1 on the wire.

        It is connected, and has at least every pixel that the wire's axis enters.

        Raises:
            ValueError: for points of another shape, not finite, or behind the source.
        """
        mask = np.empty(self.shape, np.uint8)
        self.render_into(points, None, mask)
        return mask

    def render_into(
        self, points: ArrayLike, image_out: NDArray[np.uint8] | None, mask_out: NDArray[np.uint8] | None
    ) -> None:
        """Writes image without noise and mask into the caller's arrays in one pass.

        Args:
            points: (n, 3) m, the wire's nodes in order, world frame; fewer than two draw nothing.
            image_out, mask_out: (height, width) uint8, C order; None where it is not wanted.

        Raises:
            ValueError: for points of another shape, not finite, or behind the source, or outputs that do not fit.
        """
        nodes = nodes_of(points)
        image, mask = None, None
        if image_out is not None:
            self._check_output(image_out)
            image_out[:] = self._empty
            image = image_out.ctypes.data
        if mask_out is not None:
            self._check_output(mask_out)
            mask_out.fill(0)
            mask = mask_out.ctypes.data
        state = self._draw(self._address, len(nodes), nodes.ctypes.data, image, mask)
        if state:
            raise ValueError(FAILURES[state])

    def render_over(self, image: NDArray[np.uint8], points: ArrayLike, mask_out: NDArray[np.uint8]) -> None:
        """Draws the wire into an image that has something else in it, and writes its mask.

        Args:
            image: (height, width) uint8, C order; the wire's transmission multiplies it.
            points, mask_out: as of `render_into`.

        Raises:
            ValueError: as of `render_into`.
        """
        nodes = nodes_of(points)
        self._check_output(image)
        self._check_output(mask_out)
        mask_out.fill(0)
        below = image.astype(np.float32)
        view = ViewStruct.from_buffer_copy(self._view)
        view.background = below.ctypes.data
        drawn = image.ctypes.data, mask_out.ctypes.data
        state = self._draw(ctypes.addressof(view), len(nodes), nodes.ctypes.data, *drawn)
        if state:
            raise ValueError(FAILURES[state])

    def _check_output(self, out: NDArray[np.uint8]) -> None:
        flags = out.flags
        if out.shape != self.shape or out.dtype != np.uint8 or not (flags.c_contiguous and flags.writeable):
            raise ValueError(
                f"an output must be a writeable C-ordered uint8 array of shape {self.shape}, "
                f"got {out.dtype} of shape {out.shape}."
            )


def nodes_of(points: ArrayLike) -> NDArray[np.float64]:
    """A device's nodes as the native code reads them.

    Raises:
        ValueError: they have not the shape (n, 3).
    """
    nodes = np.ascontiguousarray(points, dtype=np.float64)
    if nodes.ndim != 2 or nodes.shape[1] != 3:
        raise ValueError(f"the wire's nodes must have shape (n, 3), got {nodes.shape}.")
    return nodes


def view_struct(
    projector: Projector, grey: NDArray[np.float32], transmission: NDArray[np.float32], radius_px: float
) -> ViewStruct:
    """What draws a device of a radius over a background; both arrays must be kept as long as it is used.

    Args:
        grey: (height, width), the background.
        transmission: by squared distance from the axis, evenly over [0, (radius + 1/2)^2].
        radius_px: px, as drawn.
    """
    return ViewStruct(
        projector.width,
        projector.height,
        (ctypes.c_double * 12)(*projector.P.ravel()),
        grey.ctypes.data,
        transmission.ctypes.data,
        len(transmission),
        radius_px + 0.5,
        max(radius_px, MASK_REACH_PX),
        max(2.0, radius_px),
        None,
    )


def native_draw() -> ctypes._NamedFuncPointer:
    """cathsim_fluoroscopy_draw of fluoroscopy.c."""
    from cathsim.contact.native import library

    draw = library().cathsim_fluoroscopy_draw
    draw.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p]
    draw.restype = ctypes.c_int
    return draw


def _transmission(radius_px: float, depth: float) -> NDArray[np.float32]:
    """Grey level over background by squared distance from the wire's axis, evenly over [0, (radius + 1/2)^2]."""
    distance = np.sqrt(np.linspace(0.0, (radius_px + 0.5) ** 2, ENTRIES))
    return np.exp(-depth * mean_chord(distance, radius_px)).astype(np.float32)


def mean_chord(distance: NDArray[np.float64], radius_px: float) -> NDArray[np.float64]:
    """A cylinder's chord over its diameter, averaged over a pixel's width at distances (px) from the axis.

    The chord at distance x is 2 sqrt(r^2 - x^2); its mean has a closed form.
    """

    def area(x: NDArray[np.float64]) -> NDArray[np.float64]:
        s = np.clip(x / radius_px, -1.0, 1.0)
        return 0.5 * radius_px * (s * np.sqrt(1.0 - s * s) + np.arcsin(s))

    return area(distance + 0.5) - area(distance - 0.5)
