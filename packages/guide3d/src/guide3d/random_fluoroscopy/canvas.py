"""Canvas: the attenuation of a window of a scene, to which strokes, polygons and slow shades are added.

A scene is measured in px of the whole image, (0, 0) the centre of its top-left pixel. A window shows a part of it; what
lies outside costs little, because only the part of a shape that reaches into the window is drawn.

Attenuations add: the image is exp(-attenuation). Shapes are drawn by OpenCV in 8 bits with smooth edges (for other
depths it has none), thin ones at twice the resolution, and added with their own factor.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from guide3d.opencv import cv2

Points = NDArray[np.float64]
Image = NDArray[np.float32]

_SHIFT = 4  # bits of a pixel's fraction in OpenCV's drawing
_THIN_PX = 8.0  # strokes below are drawn at twice the resolution
_THINNEST_PX = 1.3  # width of OpenCV's smooth line of thickness 1
_REACH_SIGMAS = 2.5


class Canvas:
    """Attenuation (height, width) float32 of a window, and what was drawn on it."""

    def __init__(self, left: int, top: int, width: int, height: int) -> None:
        """Args:
        left: of the window, px of the scene; `top` as well.
        width: of the window, px; `height` as well.
        """
        self.left, self.top, self.width, self.height = left, top, width, height
        self.attenuation: Image = np.zeros((height, width), np.float32)

    def inside(self, points: Points, margin_px: float = 0.0) -> NDArray[np.bool_]:
        """Whether points (n, 2), px of the scene, lie in the window or at most `margin_px` outside."""
        x, y = points[:, 0] - self.left, points[:, 1] - self.top
        return (
            (x >= -margin_px) & (x <= self.width - 1 + margin_px)
            & (y >= -margin_px) & (y <= self.height - 1 + margin_px)
        )  # fmt: skip

    def local(self, points: Points) -> Points:
        """Points (n, 2) of the scene in px of the window."""
        return points - (self.left, self.top)

    def stroke(
        self, points: Points, width_px: float, attenuation: float, blur_px: float = 0.0, closed: bool = False
    ) -> None:
        """Adds a line of constant width along a polyline (n, 2), px of the scene, with round ends."""
        layer = self.stroke_layer(points, width_px, blur_px, closed)
        if layer is not None:
            self.add(layer[0], attenuation, layer[1], layer[2])

    def stroke_layer(
        self, points: Points, width_px: float, blur_px: float = 0.0, closed: bool = False
    ) -> tuple[NDArray[np.uint8], int, int] | None:
        """A stroke as 0 to 255 and the place of its top-left pixel in the window; None: it does not reach into it."""
        reach = width_px / 2 + _REACH_SIGMAS * blur_px + 2
        if closed:
            points = np.vstack((points, points[:1]))
        runs = self._runs(points, reach)
        if not runs:
            return None
        box = self._box(np.vstack(runs), reach)
        if box is None:
            return None
        left, top, right, bottom = box
        scale = 2 if width_px < _THIN_PX else 1
        size = scale * (bottom - top), scale * (right - left)
        # at twice the resolution, the centre of pixel (0, 0) is at (0.5, 0.5)
        fixed = [
            np.rint(((run - (self.left + left, self.top + top)) * scale + (scale - 1) / 2) * 2**_SHIFT).astype(np.int32)
            for run in runs
        ]
        thickness, share = _thickness(width_px * scale)
        layer = _line(size, fixed, thickness)
        if scale == 2:
            if share > 0.1:  # a width in between
                wider = _line(size, fixed, max(2, thickness + 2 * (thickness > 1)))
                layer = np.asarray(cv2.addWeighted(layer, 1 - share, wider, share, 0.0), np.uint8)
            layer = np.asarray(cv2.resize(layer, (right - left, bottom - top), interpolation=cv2.INTER_AREA), np.uint8)
        return blurred(layer, blur_px), left, top

    def polygon(self, points: Points, attenuation: float, blur_px: float = 0.0) -> None:
        """Adds a filled polygon (n, 2), px of the scene."""
        box = self._box(points, _REACH_SIGMAS * blur_px + 2)
        if box is None:
            return
        left, top, right, bottom = box
        layer = np.zeros((bottom - top, right - left), np.uint8)
        fixed = np.rint((points - (self.left + left, self.top + top)) * 2**_SHIFT).astype(np.int32)
        cv2.fillPoly(layer, [fixed], 255, cv2.LINE_AA, _SHIFT)
        self.add(blurred(layer, blur_px), attenuation, left, top)

    def text(self, words: str, place: Points, scale: float, thickness: int, attenuation: float) -> None:
        """Adds letters; `place`: (2,) px of the scene, lower left."""
        (width, height), _ = cv2.getTextSize(words, cv2.FONT_HERSHEY_SIMPLEX, scale, thickness)
        corners = place + np.array([[-2.0, -height - 4.0], [width + 2.0, 8.0]])
        box = self._box(corners, 2)
        if box is None:
            return
        left, top, right, bottom = box
        layer = np.zeros((bottom - top, right - left), np.uint8)
        x, y = np.rint(place - (self.left + left, self.top + top)).astype(int).tolist()
        cv2.putText(layer, words, (x, y), cv2.FONT_HERSHEY_SIMPLEX, scale, 255, thickness, cv2.LINE_AA)
        self.add(layer, attenuation, left, top)

    def shade(self, grid: NDArray[np.floating], attenuation: float) -> None:
        """Adds a coarse grid of values, stretched smoothly over the window."""
        size = (self.width, self.height)
        self.attenuation += attenuation * cv2.resize(grid.astype(np.float32), size, interpolation=cv2.INTER_CUBIC)

    def add(self, layer: NDArray[np.uint8], attenuation: float, left: int = 0, top: int = 0) -> None:
        """Adds `attenuation` where the layer (h, w) is 255, in proportion elsewhere; its corner px of the window."""
        height, width = layer.shape
        part = self.attenuation[top : top + height, left : left + width]
        cv2.addWeighted(part, 1.0, layer, attenuation / 255.0, 0.0, part, cv2.CV_32F)

    def _box(self, points: Points, reach: float) -> tuple[int, int, int, int] | None:
        """The part of the window, left, top, right, bottom (px, right and bottom outside), that points reach into."""
        low = np.floor(points.min(axis=0) - reach).astype(int) - (self.left, self.top)
        high = np.ceil(points.max(axis=0) + reach).astype(int) + 1 - (self.left, self.top)
        left, top = max(int(low[0]), 0), max(int(low[1]), 0)
        right, bottom = min(int(high[0]), self.width), min(int(high[1]), self.height)
        return None if left >= right or top >= bottom else (left, top, right, bottom)

    def _runs(self, points: Points, reach: float) -> list[Points]:
        """The pieces of a polyline of which a point or a neighbour reaches into the window."""
        if len(points) < 2:
            return []
        step = float(np.abs(np.diff(points, axis=0)).max())
        near = self.inside(points, reach + step)
        near[1:] |= near[:-1].copy()
        near[:-1] |= near[1:].copy()
        edges = np.flatnonzero(np.diff(np.concatenate(([0], near.astype(np.int8), [0]))))
        return [points[start:end] for start, end in zip(edges[::2], edges[1::2], strict=True) if end - start > 1]


def _line(size: tuple[int, int], fixed: list[NDArray[np.int32]], thickness: int) -> NDArray[np.uint8]:
    layer = np.zeros(size, np.uint8)
    cv2.polylines(layer, fixed, False, 255, thickness, cv2.LINE_AA, _SHIFT)
    return layer


def _thickness(width_px: float) -> tuple[int, float]:
    """OpenCV's thickness of a smooth line of a width or the next thinner one, and how far the width is to the next.

    OpenCV draws smooth lines of thickness 1, 2, 4, 6 .. 1.3, 3.3, 5.3, 7.3 .. px wide, and odd ones as the next even.
    """
    steps = max((width_px - _THINNEST_PX) / 2, 0.0)
    return max(1, 2 * int(steps)), steps - int(steps)


def blurred(layer: NDArray[np.uint8], sigma_px: float) -> NDArray[np.uint8]:
    """A layer (h, w) smoothed by a Gaussian; wide ones at a quarter of the resolution."""
    if sigma_px < 0.2:
        return layer
    height, width = layer.shape
    if sigma_px > 6 and min(height, width) > 16:
        small = cv2.resize(layer, (max(1, width // 4), max(1, height // 4)), interpolation=cv2.INTER_AREA)
        small = cv2.GaussianBlur(small, (0, 0), sigma_px / 4, borderType=cv2.BORDER_REPLICATE)
        return np.asarray(cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR), np.uint8)
    return np.asarray(cv2.GaussianBlur(layer, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE), np.uint8)
