"""Relief of a lumen's wall: vessels that are not quite round, and rough as segmented scans are."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from cathsim.anatomy.distance_grid import OUTSIDE, SignedDistanceGrid, in_cylinder
from cathsim.anatomy.surface import open_ends
from cathsim.anatomy.vessel_tree import VesselTree
from cathsim.validation import Unit, settings

_REACH = 4e-3  # m from the wall beyond which the distance is left as it is
_LARGE = 0.010  # m of radius from which on the coarse relief has its full height
_MOST = 0.22  # of the local radius, by which the wall is moved at most
_FLAT = 5e-3  # m of vessel before an opening over which the relief fades
_LEAST = 2.15e-3  # m of radius that the relief leaves
_SAMPLES = 2000  # places at which the height of a drawn relief is measured

Array = NDArray[np.float64]
_Height = Annotated[float, Interval(ge=0, le=2e-3), Unit("m")]
_Wave = Annotated[float, Interval(ge=2e-3, le=0.1), Unit("m")]


@settings
class WallRelief:
    """How far a wall lies from that of a round tube, root mean square, at two lengths.

    Attributes:
        coarse, coarse_length: m, makes sections oval and diameters vary; narrow vessels get less of it.
        fine, fine_length: m, makes the wall rough.
    """

    coarse: _Height = 4e-4
    coarse_length: _Wave = 0.014
    fine: _Height = 2e-4
    fine_length: _Wave = 5e-3


def raise_relief(
    grid: SignedDistanceGrid, tree: VesselTree, relief: WallRelief, rng: np.random.Generator
) -> SignedDistanceGrid:
    """The grid of a lumen whose wall has a drawn relief; the same draw at every resolution."""
    from scipy.spatial import cKDTree

    low = np.min([branch.points.min(axis=0) for branch in tree], axis=0) - 0.05
    high = np.max([branch.points.max(axis=0) for branch in tree], axis=0) + 0.05
    waves = [_Waves(low, high, length, rng) for length in (relief.coarse_length, relief.fine_length)]
    indices, values = grid.blocks.where(lambda value: value > OUTSIDE)
    near = np.abs(values) < _REACH
    place, distance = grid.coordinates(indices[near]), values[near].astype(np.float64)
    gradient = grid.gradient(place)
    gradient /= np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-6)
    foot = place - distance[:, None] * gradient  # on the wall, so that the relief is the same along its normal
    centre, radius = np.concatenate([b.points for b in tree]), np.concatenate([b.radius for b in tree])
    local = radius[cKDTree(centre).query(foot)[1]]
    height = relief.coarse * np.minimum(local / _LARGE, 1.0) * waves[0](foot) + relief.fine * waves[1](foot)
    inwards = np.minimum(_MOST * local, np.maximum(local - _LEAST, 0.0))
    height = np.clip(height, -inwards, _MOST * local)
    fade = np.clip(2 - 2 * np.abs(distance) / _REACH, 0.0, 1.0) * _away_from_ends(tree, foot)
    values = values.astype(np.float64)
    values[near] += fade * height
    values = np.maximum(values, OUTSIDE)
    return SignedDistanceGrid.from_nodes(indices, values, grid.shape, grid.origin, grid.spacing, outside=OUTSIDE)


def _away_from_ends(tree: VesselTree, points: Array) -> Array:
    """0 at the flat openings of a tree to 1 from _FLAT (m) inside them on: openings stay flat and where they are."""
    share = np.ones(len(points))
    for centre, normal, radius in open_ends(tree):
        end_zone, height = in_cylinder(points, centre, normal, (-_FLAT, _FLAT), 1.5 * radius)
        share[end_zone] = np.minimum(share[end_zone], np.clip(-height / _FLAT, 0.0, 1.0))
    return share


class _Waves:
    """A smooth random field of mean square 1 and a given length, in a box."""

    def __init__(self, low: Array, high: Array, length: float, rng: np.random.Generator) -> None:
        from scipy.ndimage import spline_filter

        # a cubic spline through independent values 0.5 lengths apart turns over about a length
        self._low, self._step = low, 0.5 * length
        self._nodes = spline_filter(rng.normal(size=np.ceil((high - low) / self._step).astype(int) + 2))
        self._scale = 1.0
        self._scale = 1 / float(np.std(self(rng.uniform(low, high, (_SAMPLES, 3)))))

    def __call__(self, points: Array) -> Array:
        """Values (n,) at points (n, 3) m."""
        from scipy.ndimage import map_coordinates

        at = ((points - self._low) / self._step).T
        return self._scale * map_coordinates(self._nodes, at, order=3, prefilter=False, mode="reflect")
