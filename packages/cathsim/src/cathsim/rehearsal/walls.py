"""A phantom whose walls lie elsewhere than its scan's, smoothly."""

from __future__ import annotations

import dataclasses
import threading
from typing import Any, NamedTuple
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cathsim.anatomy import Phantom
from cathsim.anatomy.distance_grid import SignedDistanceGrid
from cathsim.anatomy.vessel_tree import VesselTree
from cathsim.anatomy.wall.thickness import THINNEST, walls_between_lumens
from cathsim.lifetime_cache import kept_with_owner

MODES = 24  # waves of which the displacement is the sum
WAVES = 0.030, 0.080  # m: shortest and longest of them
BAND = 0.004  # m: beyond this distance from the wall nothing changes
NARROWEST = 0.4  # of a branch's radius at most is lost
BESIDE = 0.004  # m from a wall between two lumens, over which they begin to grow again
_NEIGHBOURS = 6  # balls of a wall that a node is compared with

_copies: WeakValueDictionary[tuple[str, int, float], Phantom] = WeakValueDictionary()
_making = threading.RLock()


def displaced_walls(phantom: Phantom, seed: int, farthest: float) -> Phantom:
    """A phantom with walls displaced outwards or inwards by a smooth random field.

    The field is a sum of waves of 30 to 80 mm in all directions, cut at twice its standard deviation. No branch loses
    more than 40 % of its radius. A wall between two lumens becomes no thinner, so that no way leads through it.
    Targets, entries, centrelines and the distances along the lumen are those of the scan.

    Args:
        seed: of the field.
        farthest: largest displacement, m.

    Returns:
        The copy; calls with the same arguments share one object while it is used.
    """
    key = (phantom.hash, seed, farthest)
    with _making:
        copy = _copies.get(key)
        if copy is None:
            copy = _copies[key] = _displaced(phantom, seed, farthest)
        return copy


def wall_field(points: NDArray[np.floating[Any]], seed: int) -> NDArray[np.float32]:
    """The displacement of the walls at points (n, 3) m as a share of the largest, outwards positive. Shape (n,)."""
    generator = np.random.default_rng(seed)
    directions = generator.standard_normal((MODES, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    waves = directions * (2 * np.pi / generator.uniform(*WAVES, (MODES, 1)))
    phases = generator.uniform(0.0, 2 * np.pi, MODES)
    total = np.zeros(len(points), np.float32)  # good to 1e-5 of a wave, 10 nm
    where = np.asarray(points, np.float32)
    for wave, phase in zip(waves.astype(np.float32), phases.astype(np.float32), strict=True):
        total += np.cos(where @ wave + phase)
    return np.clip(total / np.float32(2 * np.sqrt(MODES / 2)), -1.0, 1.0)


class _Walls(NamedTuple):
    """The nodes of a scan's grid near its walls, which every copy displaces."""

    indices: NDArray[np.integer[Any]]  # of all nodes that know their distance. Shape (m, 3).
    values: NDArray[np.float32]  # their distances, m. Shape (m,).
    near: NDArray[np.intp]  # which of them are nearer than `BAND`. Shape (n,).
    points: NDArray[np.float32]  # where these are, m. Shape (n, 3).
    radius: NDArray[np.float32]  # of the lumen there, m. Shape (n,).
    fading: NDArray[np.float32]  # 1 at the wall, 0 at the band's edge. Shape (n,).


@kept_with_owner
def _walls(phantom: Phantom) -> _Walls:
    grid = phantom.grid
    clamp = grid.blocks.constant
    indices, values = grid.blocks.where(lambda value: value != clamp)
    near = np.flatnonzero(np.abs(values) < BAND)
    points = grid.coordinates(indices[near])
    fading = 1.0 - np.square(values[near] / BAND)
    radius = _radius_at(phantom.tree, points)
    return _Walls(indices, values, near, *(array.astype(np.float32) for array in (points, radius, fading)))


def _displaced(phantom: Phantom, seed: int, farthest: float) -> Phantom:
    grid, walls = phantom.grid, _walls(phantom)
    moved = np.maximum(farthest * wall_field(walls.points, seed), -NARROWEST * walls.radius)
    moved *= np.where(moved > 0, _share_outwards(grid, farthest), 1.0)
    values = walls.values.copy()
    # full at the wall, nothing at the band's edge, so that what lies farther off stays as it is
    values[walls.near] += moved * walls.fading
    outside = grid.blocks.constant
    displaced = SignedDistanceGrid.from_nodes(
        walls.indices, values, grid.shape, grid.origin, grid.spacing, outside=outside
    )
    return dataclasses.replace(
        phantom,
        name=f"{phantom.name}_copy{seed}",
        hash=f"{phantom.hash}:{seed}:{farthest:g}",
        parameters=None,
        source=None,
        grid=displaced,
        _load_field=phantom.geodesic_field,
        _save_field=None,
        _fields={},
    )


@kept_with_owner
def _share_outwards(grid: SignedDistanceGrid, farthest: float) -> NDArray[np.float32]:
    """Which share of a displacement outwards the nodes near a scan's walls get: 0 at walls between lumens, else 1.

    Shape (n,): those nearer than `BAND`, in the grid's order.
    """
    indices, values = grid.blocks.where(lambda value: np.abs(value) < BAND)
    centres, radii = walls_between_lumens(grid, THINNEST + 2 * farthest)
    if not len(centres):
        return np.ones(len(values), np.float32)
    away, nearest = cKDTree(centres).query(grid.coordinates(indices), k=range(1, _NEIGHBOURS + 1))
    beyond = (away - np.append(radii, 0.0)[nearest]).min(axis=1)
    return np.clip(beyond / BESIDE, 0.0, 1.0).astype(np.float32)


def _radius_at(tree: VesselTree, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Radius of the lumen where the centrelines are nearest to points (n, 3) m. Shape (n,), m."""
    nearest = cKDTree(np.concatenate([branch.points for branch in tree])).query(points)[1]
    return np.concatenate([branch.radius for branch in tree])[nearest]
