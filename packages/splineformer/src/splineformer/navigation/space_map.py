"""Space map: the lumen in space as two contrast runs leave it open, and the ways through it to the target.

What both cameras show as lumen is the hull of the vessels: all of them, and what lies between them where one camera
looks along it. A way through it is no longer led astray by vessels that cross in one of the pictures.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from skimage.graph import MCP_Geometric

from guide3d.geometry.camera import Camera
from guide3d.geometry.triangulation import triangulate
from guide3d.image_filters import largest_around, sampled
from splineformer.navigation.vessel_map import OUTSIDE_COST, WALL_COST

Array = NDArray[np.float64]

CELL_MM = 3.0
_REACH_MM = 160.0  # to each side of the place where the optical axes meet: patients are looked at from within
_COARSE = 4  # cells: the box round the lumen is found with such steps
_MARGIN = 3  # cells round the lumen
_PULL, _PULLS = 6.0, 3  # how far a way is pulled tight, how often
_WITHIN = 0.7  # of the lumen: where a way may be pulled to


@dataclass(frozen=True, eq=False)
class Hull:
    """What both cameras show as lumen.

    Attributes:
        cameras: two, of undistorted images.
        lumen: (l, m, n) in 0 to 1, along x, y and z.
        origin_mm: (3,) the first cell's centre, world.
    """

    cameras: tuple[Camera, Camera]
    lumen: NDArray[np.float32]
    origin_mm: Array


def hull_of(lumens: Sequence[ArrayLike], cameras: Sequence[Camera]) -> Hull:
    """Carves the hull of the lumen from two contrast runs.

    Args:
        lumens: (n, n) of each camera, as `vessel_map.lumen_of_run` gives them.
        cameras: two, world in mm.

    Raises:
        ValueError: not two cameras, or runs that have no lumen in common.
    """
    if len(cameras) != 2 or len(lumens) != 2:
        raise ValueError(f"expected two cameras and their lumens, got {len(cameras)} and {len(lumens)}")
    maps = [np.asarray(lumen, float) for lumen in lumens]
    middle = _meeting(cameras)
    count = round(2 * _REACH_MM / (CELL_MM * _COARSE)) + 1
    first = middle - _REACH_MM
    rough = _carved(maps, cameras, first, (count,) * 3, CELL_MM * _COARSE, spread=True)
    voxels = np.argwhere(rough > 0.5)
    if not len(voxels):
        raise ValueError("the contrast runs have no lumen in common: look whether the cameras belong to the images")
    low = _COARSE * (voxels.min(0) - 1) - _MARGIN
    shape = _COARSE * (voxels.max(0) + 1) + _MARGIN - low + 1
    origin = first + CELL_MM * low
    return Hull((cameras[0], cameras[1]), _carved(maps, cameras, origin, tuple(shape.tolist()), CELL_MM), origin)


def _meeting(cameras: Sequence[Camera]) -> Array:
    """The place nearest to all optical axes, mm."""
    across = [np.eye(3) - np.outer(camera.R[2], camera.R[2]) for camera in cameras]
    right = sum(matrix @ camera.centre_mm for matrix, camera in zip(across, cameras, strict=True))
    return np.asarray(np.linalg.solve(sum(across), right))


def _carved(
    maps: Sequence[Array], cameras: Sequence[Camera], origin: Array, shape: tuple[int, ...], step: float,
    *, spread: bool = False,
) -> NDArray[np.float32]:  # fmt: skip
    axes = [origin[k] + step * np.arange(shape[k]) for k in range(3)]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    left = np.ones(len(places))
    for lumen, camera in zip(maps, cameras, strict=True):
        if spread:  # a step must not jump over a vessel
            lumen = largest_around(lumen, 2 * _COARSE + 1)
        cells = (camera.project(places) + 0.5) * len(lumen) / camera.width - 0.5
        left = np.minimum(left, sampled(lumen, cells[:, 0], cells[:, 1], outside=0.0))
    return left.reshape(shape).astype(np.float32)


class SpaceMap:
    """Ways through a hull to a target; places are in mm, world.

    Args:
        marks: (2,) of each camera, the target's mark as shares of the image's sides.
    """

    def __init__(self, hull: Hull, marks: Sequence[ArrayLike]) -> None:
        self.hull = hull
        a, b = (
            np.asarray(mark, float)[None] * (camera.width, camera.height) - 0.5
            for mark, camera in zip(marks, hull.cameras, strict=True)
        )
        self.target = triangulate(*hull.cameras, a, b)[0]
        shape = hull.lumen.shape
        depth = ndimage.distance_transform_edt(hull.lumen > 0.5)
        cost = 1.0 + (OUTSIDE_COST - 1.0) * (1.0 - hull.lumen) ** 2 + WALL_COST / (1.0 + depth)
        self._highest = np.array(shape) - 2  # the outermost cells have no neighbours all round
        length = MCP_Geometric(cost).find_costs([self._cell(self.target)])[0] * CELL_MM
        self._length = np.asarray(length, np.float32)
        around = np.array(list(itertools.product((-1, 0, 1), repeat=3)))
        self._around = around @ (shape[1] * shape[2], shape[2], 1)

    def _cell(self, place: ArrayLike) -> tuple[int, ...]:
        cell = np.rint((np.asarray(place) - self.hull.origin_mm) / CELL_MM).astype(int)
        return tuple(np.clip(cell, 1, self._highest).tolist())

    def remaining(self, place: ArrayLike) -> float:
        """Cost of the way from a (3,) place to the target, mm; more than its length."""
        return float(self._length[self._cell(place)])

    def way(self, place: ArrayLike, reach_mm: float = np.inf) -> Array:
        """The (n, 3) points of the way from a place to the target.

        Args:
            place: (3,) where it begins.
            reach_mm: the rest of the way beyond is left out.
        """
        flat, shape = self._length.ravel(), self._length.shape
        cell = int(np.ravel_multi_index(self._cell(place), shape))
        cells = [cell]
        while len(cells) * CELL_MM < reach_mm + 2 * CELL_MM and flat[cell] > 0:
            cell += int(self._around[flat[cell + self._around].argmin()])
            cells.append(cell)
        points = self.hull.origin_mm + CELL_MM * np.stack(np.unravel_index(cells, shape), axis=1)
        points[0] = place
        if flat[cell] <= 0:
            points = np.concatenate([points[: max(len(points) - 1, 1)], self.target[None]])
        return self._tightened(points)

    def _tightened(self, points: Array) -> Array:
        """The way, whose steps from cell to cell know few directions, pulled tight where that stays in the lumen."""
        pull = _pulling(len(points))
        for _ in range(_PULLS):
            pulled = pull @ points
            free = self.sample(pulled) > _WITHIN
            points = np.where(free[:, None], pulled, points)
        return points

    def sample(self, places: ArrayLike) -> Array:
        """The lumen at (..., 3) places; 0 outside the hull."""
        places = np.asarray(places, float)
        cells = ((places - self.hull.origin_mm) / CELL_MM).reshape(-1, 3).T
        return np.asarray(ndimage.map_coordinates(self.hull.lumen, cells, order=1)).reshape(places.shape[:-1])


@functools.lru_cache(maxsize=256)
def _pulling(count: int) -> Array:
    """The (count, count) matrix that pulls a way of so many points tight."""
    tight = np.eye(count)
    tight[1:-1] -= _PULL * np.diff(tight, 2, axis=0)
    return np.asarray(np.linalg.inv(tight), float)
