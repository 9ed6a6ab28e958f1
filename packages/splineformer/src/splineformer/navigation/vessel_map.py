"""Vessel map: the lumen that a contrast run shows, and the ways through it to the target's mark.

A contrast run is two images of a still camera before the wire moves, without and with contrast medium. The logarithm
of their quotient is the contrast's thickness along each ray and nothing else. Everything here is in the plane of the
image: where vessels cross in projection, the way may take the crossing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from skimage.graph import MCP_Geometric

from guide3d.image_filters import sampled
from guide3d.opencv import cv2

Array = NDArray[np.float64]

MAP_SIZE = 128  # cells along a side
OUTSIDE_COST = 12.0  # a way outside the lumen counts as so many times longer
WALL_COST = 1.5  # a way along the wall counts as so much longer than one in the middle
_DARKEST = 8.0  # grey levels below are no exposure: the collimator's rim
_LEAST_CONTRAST = 0.03  # of the logarithm: less is noise, and the run shows no vessel
_BACKGROUND_PCT = 30.0  # of the exposed cells: these show no vessel
_THIN = 0.12  # of the thickest lumen: from here on a vessel counts as one
_SOFT = 0.15  # of that: width of the border between lumen and tissue
_SMALLEST = 20  # cells of a piece of lumen that counts


def lumen_of_run(plain: ArrayLike, contrast: ArrayLike, size: int = MAP_SIZE) -> Array:
    """The lumen that a contrast run shows.

    Args:
        plain: (h, h) grey levels without contrast medium.
        contrast: (h, h) with it, from the same camera.

    Returns:
        (size, size) in 0 to 1, 1 where there is lumen.

    Raises:
        ValueError: images of different or no square shapes, or without a difference.
    """
    before, after = np.asarray(plain, np.float32), np.asarray(contrast, np.float32)
    if before.shape != after.shape or before.ndim != 2 or before.shape[0] != before.shape[1]:
        raise ValueError(f"expected two square images of one shape, got {before.shape} and {after.shape}")
    small = [cv2.resize(image, (size, size), interpolation=cv2.INTER_AREA).astype(float) for image in (before, after)]
    exposed = np.minimum(*small) > _DARKEST
    if not exposed.any():
        raise ValueError("the contrast run shows nothing: its images are black")
    thickness = np.zeros((size, size))
    thickness[exposed] = np.log(small[0][exposed]) - np.log(small[1][exposed])
    # automatic brightness lifts or lowers a whole image, so what shows no vessel is not at zero
    thickness[exposed] -= np.percentile(thickness[exposed], _BACKGROUND_PCT)
    thickest = float(np.percentile(thickness, 99.5))
    if thickest < _LEAST_CONTRAST:
        raise ValueError("the contrast run shows no vessel: its two images hardly differ")
    level = _THIN * thickest
    lumen = 1.0 / (1.0 + np.exp(-np.clip((thickness - level) / (_SOFT * level), -50, 50)))
    _, pieces, boxes, _ = cv2.connectedComponentsWithStats((lumen > 0.5).astype(np.uint8), connectivity=8)
    sizes = boxes[:, cv2.CC_STAT_AREA]
    return np.where((pieces > 0) & (sizes[pieces] < _SMALLEST), 0.0, lumen)


class VesselMap:
    """Ways through a lumen to a mark; the image's sides are 1, places are x and y.

    Args:
        lumen: (n, n) in 0 to 1.
        target: (2,) the mark.

    Raises:
        ValueError: the mark lies outside the image.
    """

    def __init__(self, lumen: ArrayLike, target: ArrayLike) -> None:
        self.lumen = np.asarray(lumen, float)
        self.target = np.asarray(target, float)
        self.size = len(self.lumen)
        if not ((self.target >= 0) & (self.target < 1)).all():
            raise ValueError(f"the target's mark must lie in the image, got {self.target.tolist()} of 1 x 1")
        inside = (self.lumen > 0.5).astype(np.uint8)
        depth = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE).astype(float)
        cost = 1.0 + (OUTSIDE_COST - 1.0) * (1.0 - self.lumen) ** 2 + WALL_COST / (1.0 + depth)
        self._search = MCP_Geometric(cost)
        self._length = self._search.find_costs([self._cell(self.target)])[0] / self.size

    def _cell(self, place: Array) -> tuple[int, int]:
        column, row = np.clip((np.asarray(place) * self.size).astype(int), 0, self.size - 1)
        return int(row), int(column)

    def remaining(self, place: Array) -> float:
        """Cost of the way from a place to the mark, in sides of the image; more than its length."""
        return float(self._length[self._cell(place)])

    def way(self, place: Array) -> Array:
        """The (n, 2) points of the way from a place to the mark, both ends among them."""
        cells = np.array(self._search.traceback(self._cell(place))[::-1], float)
        points = (cells[:, ::-1] + 0.5) / self.size
        points = np.concatenate([np.asarray(place, float)[None], points[1:], self.target[None]])
        if len(points) > 4:  # steps from cell to cell know eight directions only
            points[1:-1] = 0.25 * points[:-2] + 0.5 * points[1:-1] + 0.25 * points[2:]
            points[1:-1] = 0.25 * points[:-2] + 0.5 * points[1:-1] + 0.25 * points[2:]
        return points

    def sample(self, places: Array) -> Array:
        """The lumen at (..., 2) places; outside the image that of its border."""
        places = np.asarray(places, float)
        at = places * self.size - 0.5
        return sampled(self.lumen, at[..., 0], at[..., 1])
