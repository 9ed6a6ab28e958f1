"""Filters of grey images by OpenCV. Where a filter looks beyond the border, it sees the image mirrored there."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from guide3d.opencv import cv2

_REACH = 4.0  # of a Gaussian's standard deviations, beyond which it counts as 0
_MIRRORED = cv2.BORDER_REFLECT
_MAP_WIDTH = 1024


def blurred(image: np.ndarray, sigma: float) -> np.ndarray:
    """The image (h, w), float32 or float64, under a Gaussian of `sigma` px; of the same type."""
    side = 2 * _reach(sigma) + 1
    return np.asarray(cv2.GaussianBlur(image, (side, side), sigma, borderType=_MIRRORED))


def laplacian(image: np.ndarray, sigma: float) -> np.ndarray:
    """The Laplacian (h, w) of a float image (h, w) under a Gaussian of `sigma` px, per px^2."""
    smooth, bent = _gaussian_kernels(sigma)
    along_x = cv2.sepFilter2D(image, -1, bent, smooth, borderType=_MIRRORED)
    return np.asarray(along_x + cv2.sepFilter2D(image, -1, smooth, bent, borderType=_MIRRORED))


def largest_around(image: np.ndarray, side: int) -> np.ndarray:
    """The greatest value (h, w) within a square of an odd side about each pixel."""
    return np.asarray(cv2.dilate(image, _square(side)))


def least_around(image: np.ndarray, side: int) -> np.ndarray:
    """The least value (h, w) within a square of an odd side about each pixel."""
    return np.asarray(cv2.erode(image, _square(side)))


def closed(image: np.ndarray, side: int) -> np.ndarray:
    """Closing: what is darker than its surroundings and narrower than a square of an odd side is filled up."""
    return np.asarray(cv2.morphologyEx(image, cv2.MORPH_CLOSE, _square(side)))


def white_tophat(image: np.ndarray, side: int) -> np.ndarray:
    """How much brighter (h, w) than its surroundings is what is narrower than a square of some side, odd or even."""
    # the second pass looks the other way, or an even square would shift the image by a pixel
    opened = cv2.dilate(cv2.erode(image, _square(side)), _square(side), anchor=((side - 1) // 2,) * 2)
    return np.asarray(image - opened)


def mean_around(image: np.ndarray, side: int) -> np.ndarray:
    """The mean within a square of an odd side about each pixel, of the same type; the border's pixels go on outside."""
    return np.asarray(cv2.blur(image, (side, side), borderType=cv2.BORDER_REPLICATE))


def sampled(image: np.ndarray, x: np.ndarray, y: np.ndarray, outside: float | None = None) -> np.ndarray:
    """Values at places of an image (h, w) of floats, bilinear between pixels, to seven digits; of the same type.

    Args:
        x, y: columns and rows, of any one shape.
        outside: value beyond the border; None: that of the nearest pixel.
    """
    # OpenCV takes maps of up to 32,767 rows and columns, and places to 1/32 px if the image is float64
    width, rows = min(max(x.size, 1), _MAP_WIDTH), -(-max(x.size, 1) // _MAP_WIDTH)
    if rows > 16 * _MAP_WIDTH:
        halves = np.array_split(x.ravel(), 2), np.array_split(y.ravel(), 2)
        return np.concatenate([sampled(image, *half, outside) for half in zip(*halves, strict=True)]).reshape(x.shape)
    maps = np.zeros((2, rows, width), np.float32)
    maps.reshape(2, -1)[:, : x.size] = x.ravel(), y.ravel()
    border = cv2.BORDER_REPLICATE if outside is None else cv2.BORDER_CONSTANT
    grey, beyond = image.astype(np.float32), outside or 0.0
    values = cv2.remap(grey, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=border, borderValue=beyond)
    return values.astype(image.dtype).ravel()[: x.size].reshape(x.shape)


@lru_cache(maxsize=64)
def _square(side: int) -> np.ndarray:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_RECT, (side, side)))


def _reach(sigma: float) -> int:
    return int(_REACH * sigma + 0.5)


@lru_cache(maxsize=64)
def _gaussian_kernels(sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """A Gaussian and its second derivative, (2 reach + 1,) each."""
    x = np.arange(-_reach(sigma), _reach(sigma) + 1)
    smooth = np.exp(-0.5 * (x / sigma) ** 2)
    smooth /= smooth.sum()
    return smooth, smooth * (x**2 / sigma**4 - 1 / sigma**2)
