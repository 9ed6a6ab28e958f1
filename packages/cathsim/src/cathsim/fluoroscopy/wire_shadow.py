"""The wire's shadow: transmission across its width, drawn along its distorted centreline, and its mask."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cathsim.fluoroscopy.c_arms import XRayCamera
from cathsim.fluoroscopy.curve import smooth_curve
from cathsim.fluoroscopy.materials import WireMaterial
from cathsim.fluoroscopy.renderer import MASK_REACH_PX, MINIMUM_WIDTH_PX

Array = NDArray[np.float64]

_ENTRIES, _ROWS = 512, 32
_SPREAD = (0.7, 1.4)  # range of wire radii a camera is prepared for, over that at its middle
_PIECE_PX = 1.5  # length of the straight pieces that the curve is drawn in


class _WindowStruct(ctypes.Structure):
    """struct WireWindow of fluoroscopy_detector.c."""

    _fields_ = (
        *((name, ctypes.c_int) for name in ("left", "top", "width", "height", "sections", "rows", "entries")),
        *((name, ctypes.c_void_p) for name in ("profiles", "reach", "mask_reach")),
        ("apart", ctypes.c_float),
    )


@dataclass(frozen=True, eq=False)
class ShadowWindow:
    """A wire's shadow in the window of an image that it touches.

    Attributes:
        left, top: px, the window's first column and row.
        transmission: (height, width) float32.
        mask: (height, width) uint8, 1 on the wire.
    """

    left: int
    top: int
    transmission: NDArray[np.float32]
    mask: NDArray[np.uint8]

    @property
    def ends(self) -> tuple[int, int]:
        """px, the column and the row after the window's last."""
        return self.left + self.mask.shape[1], self.top + self.mask.shape[0]

    def whole_mask(self, shape: tuple[int, int]) -> NDArray[np.uint8]:
        """The mask in an image of a shape (height, width)."""
        mask = np.zeros(shape, np.uint8)
        mask[self.top : self.ends[1], self.left : self.ends[0]] = self.mask
        return mask


def overlaid(first: ShadowWindow | None, second: ShadowWindow | None) -> ShadowWindow | None:
    """Two devices' shadows as one: transmissions multiply, and the mask is the union."""
    if first is None or second is None:
        return first if second is None else second
    left, top = min(first.left, second.left), min(first.top, second.top)
    right, bottom = (max(ends) for ends in zip(first.ends, second.ends, strict=True))
    transmission = np.ones((bottom - top, right - left), np.float32)
    mask = np.zeros(transmission.shape, np.uint8)
    for one in (first, second):
        window = np.s_[one.top - top : one.ends[1] - top, one.left - left : one.ends[0] - left]
        transmission[window] *= one.transmission
        mask[window] |= one.mask
    return ShadowWindow(left, top, transmission, mask)


class WireShadow:
    """Draws a wire's shadow for one camera; safe to share between threads.

    Every pixel's transmission is that of nested cylinders, averaged over the pixel and over the focal spot's blur;
    where two stretches of the wire cross, both attenuate. A wire thinner than 1.2 px is drawn that wide, so that it
    does not vanish from small images.

    Args:
        material: the wire's sections from the tip.
        centre: (3,) m, a point in the middle of where the wire will be.
        hollow: of a tube, which is darkest off its axis: of pieces that follow each other the nearest is drawn, not
            the darkest.
    """

    def __init__(self, camera: XRayCamera, material: WireMaterial, centre: ArrayLike, *, hollow: bool = False) -> None:
        from cathsim.contact.native import library

        self.camera, self.material, self._hollow = camera, material, hollow
        projector, detector = camera.projector, camera.detector
        scale = projector.pixels_per_metre(centre)
        self._least = MINIMUM_WIDTH_PX / 2
        low, high = (max(share * material.radius * scale, self._least) for share in _SPREAD)
        self._radii = np.geomspace(low, max(high, 1.01 * low), _ROWS)
        blur = detector.focal_blur * detector.scale(projector.width, projector.height)
        sections = material.sections
        reach = np.empty((len(sections), _ROWS), np.float32)
        self._profiles = np.empty((len(sections), _ROWS, _ENTRIES), np.float32)
        for i, section in enumerate(sections):
            for j, radius in enumerate(self._radii):
                own = max(radius * section.radius / material.radius, self._least)
                reach[i, j] = own + 0.5 + 3 * blur
                distance = np.sqrt(np.linspace(0.0, reach[i, j] ** 2, _ENTRIES))
                self._profiles[i, j] = _transmission(distance, own, section.radius, section.depth, blur)
        self._profiles[:, :, -1] = 1.0
        self._reach, self._mask_reach = reach, np.maximum(self._radii, MASK_REACH_PX).astype(np.float32)
        self._margin = float(max(reach.max(), self._mask_reach.max())) + 1.0
        self._spacing = _PIECE_PX / scale
        draw = library().cathsim_wire_draw
        draw.argtypes = (ctypes.c_void_p, ctypes.c_int, *(ctypes.c_void_p,) * 9)
        draw.restype = None
        self._draw = draw

    def centreline(self, nodes: ArrayLike) -> tuple[Array, Array, Array]:
        """The smooth axis, as the detector shows it, of a wire's nodes (n, 3) m from the tip.

        Returns:
            (m, 2) px, distorted; (m,) m, the arc length of each from the tip; (m,) px, the wire's radius there.

        Raises:
            ValueError: for nodes of another shape, not finite, or behind the source.
        """
        points, arc = smooth_curve(nodes, self._spacing)
        if len(points) < 2:
            return np.empty((0, 2)), np.empty(0), np.empty(0)
        projector, distortion = self.camera.projector, self.camera.distortion
        ideal = projector.project(points)
        depth = points @ projector.R[2] + projector.t[2]
        radius = self.material.radius * projector.K[0, 0] / depth
        if not distortion.identity:
            # a strip along the tangent keeps its area times det J and is stretched along itself by |J tangent|
            tangent = np.gradient(ideal, axis=0)
            tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
            J = distortion.jacobian(ideal)
            stretch = np.linalg.norm(np.einsum("nij,nj->ni", J, tangent), axis=1)
            radius = radius * np.where(stretch > 1e-6, np.linalg.det(J) / np.maximum(stretch, 1e-6), 1.0)
        return distortion.distort(ideal), arc, radius

    def shadow(self, nodes: ArrayLike) -> ShadowWindow | None:
        """Transmission and mask of a wire's nodes (n, 3) m from the tip; None where it does not touch the image.

        Raises:
            ValueError: for nodes of another shape, not finite, or behind the source.
        """
        pixels, arc, radius = self.centreline(nodes)
        projector = self.camera.projector
        size = np.array([projector.width, projector.height])
        near = (pixels > -self._margin) & (pixels < size - 1 + self._margin)
        inside = np.logical_and(near[:, 0], near[:, 1])
        touching = np.logical_or(inside[:-1], inside[1:])
        if not touching.any():
            return None
        corners = np.concatenate((pixels[:-1][touching], pixels[1:][touching]))
        low = np.clip(np.floor(corners.min(axis=0) - self._margin), 0, size - 1).astype(int)
        high = np.clip(np.ceil(corners.max(axis=0) + self._margin), 0, size - 1).astype(int)
        width, height = (high - low + 1).tolist()
        strand = np.ones((height, width), np.float32)
        under, last = np.ones_like(strand), np.full_like(strand, -1e9)
        mask = np.zeros((height, width), np.uint8)
        along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(pixels, axis=0), axis=1))))
        middle = (arc[:-1] + arc[1:]) / 2
        section = np.searchsorted(self.material.starts, middle, side="right") - 1
        steps = np.log(self._radii[-1] / self._radii[0]) / (_ROWS - 1)
        row = np.clip(np.rint(np.log(np.maximum(radius[:-1], 1e-6) / self._radii[0]) / steps), 0, _ROWS - 1)
        arrays = (
            np.ascontiguousarray(pixels, np.float32),
            np.ascontiguousarray(along, np.float32),
            np.ascontiguousarray(section, np.int32),
            np.ascontiguousarray(row, np.int32),
            strand,
            under,
            last,
            mask,
        )
        window = _WindowStruct(
            *(int(low[0]), int(low[1]), width, height, len(self.material.sections), _ROWS, _ENTRIES),
            *(table.ctypes.data for table in (self._profiles, self._reach, self._mask_reach)),
            2 * self._margin + 4 * _PIECE_PX,
        )
        nearest = np.full_like(strand, np.inf) if self._hollow else None
        drawn = (*(array.ctypes.data for array in arrays), None if nearest is None else nearest.ctypes.data)
        self._draw(ctypes.addressof(window), len(pixels), *drawn)
        return ShadowWindow(int(low[0]), int(low[1]), strand, mask)


def _transmission(
    distance: Array, radius_px: float, radius: float, depth: Callable[[Array], Array], blur: float
) -> Array:
    """Transmission at distances (px) from the axis of a long wire, over a pixel's width and a Gaussian blur (px)."""
    fine = min(radius_px, 1.0) / 64
    x = np.arange(-(distance.max() + 1 + 4 * blur), distance.max() + 1 + 4 * blur, fine)
    sharp = np.exp(-depth(x * (radius / radius_px)))
    width = max(1, round(1 / fine))
    kernel = np.ones(width)
    if blur > 0:
        k = np.arange(-4 * blur, 4 * blur + fine, fine)
        kernel = np.convolve(kernel, np.exp(-0.5 * np.square(k / blur)))
    if len(kernel) % 2 == 0:  # keeps the middle on a sample
        kernel = np.convolve(kernel, [0.5, 0.5])
    soft = 1 - np.convolve(1 - sharp, kernel / kernel.sum(), mode="same")
    return np.interp(distance, x, soft)
