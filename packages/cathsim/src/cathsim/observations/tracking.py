"""Tracked points of the wire in one view, with the target and the last action: an observation without images.

Source: three points 2 mm apart, of this step and of the one before, in a parallel projection turned by 25 degrees, are
what the task ArchVariety observes (Karstensen et al. 2024, arXiv 2410.01956, and the training published with it; the
order of both turns: eve/util/coordtransform.py of lkarstensen/stEVE).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy import Phantom
from cathsim.anatomy.centreline import arc_length
from cathsim.devices.simulation import DualSimulation
from cathsim.lifetime_cache import kept_with_owner
from cathsim.observations.roadmap import Roadmap
from cathsim.simulation import Simulation

POINTS, MOMENTS = 3, 2
SPACING = 2e-3  # m between the points, in the view
# degrees: the vessels are turned by the second about the axis to the left, then by the first about the superior one
VIEW = (25.0, 0.0)
MARGIN = 0.1  # of the centrelines' extent, on either side

Array = NDArray[np.float64]


def in_view(points: Array, view: tuple[float, float] = VIEW) -> Array:
    """Points (..., 3) m, world frame, in a view: (..., 2) m to the right of the picture and up."""
    turn, tilt = map(math.radians, view)
    x, y, z = np.moveaxis(points, -1, 0)
    depth = math.cos(tilt) * y + math.sin(tilt) * z
    return np.stack((math.cos(turn) * x + math.sin(turn) * depth, math.cos(tilt) * z - math.sin(tilt) * y), axis=-1)


@kept_with_owner
def viewed_range(phantom: Phantom, view: tuple[float, float] = VIEW) -> Array:
    """Lowest and highest place (2, 2) m in a view that are shown as -1 and 1."""
    seen = in_view(np.concatenate([branch.points for branch in phantom.tree]), view)
    low, high = seen.min(axis=0), seen.max(axis=0)
    return np.stack((low - MARGIN * (high - low), high + MARGIN * (high - low)))


class Tracking:
    """Follows points of the wire's end in the view through an episode.

    Args:
        roadmap: knows where the target is.
        view: as `VIEW`.
    """

    def __init__(self, simulation: Simulation, roadmap: Roadmap, view: tuple[float, float] = VIEW) -> None:
        self.simulation, self._roadmap, self.view = simulation, roadmap, view
        both = isinstance(simulation, DualSimulation) and simulation.pair.both
        self._feeders = 2 if both else 1
        self.size = 2 * (POINTS * MOMENTS + 1 + self._feeders)
        self._low, self._high = viewed_range(simulation.phantom, view)
        self._seen, self._moves = np.zeros((MOMENTS, POINTS, 2)), np.zeros(2 * self._feeders)

    def begin(self) -> None:
        """Starts with the present moment, as if it had been so before."""
        self._seen[:] = self.tracked()
        self._moves[:] = 0.0

    def advance(self, moves: Any) -> None:
        """Records a control step: translation and rotation of each feeder as shares of the largest, -1 to 1."""
        self._seen = np.concatenate((self.tracked()[None], self._seen[:-1]))
        self._moves[:] = moves

    def tracked(self) -> Array:
        """The tip and the points behind it, SPACING apart along the projected wire. Shape (POINTS, 2), m."""
        line = in_view(self.simulation.inserted_points(), self.view)
        along = arc_length(line)
        lengths = SPACING * np.arange(POINTS)
        return np.stack([np.interp(lengths, along, line[:, axis]) for axis in range(2)], axis=-1)

    def read(self) -> np.ndarray:
        """Points of this moment, then of the one before, the target, the last moves (16,), with two devices (18,).

        float32; places as shares of the view's range, -1 to 1.
        """
        goal = in_view(self._roadmap.goal, self.view)
        places = np.concatenate((self._seen.reshape(-1, 2), goal[None]))
        shares = 2 * (places - self._low) / (self._high - self._low) - 1
        return np.concatenate((shares.ravel(), self._moves)).astype(np.float32)

    def state(self) -> dict[str, Any]:
        """All of it, to be pickled; for `restore`."""
        return {"seen": self._seen.copy(), "moves": self._moves.copy()}

    def restore(self, state: dict[str, Any]) -> None:
        """Returns to a saved moment."""
        self._seen, self._moves = state["seen"].copy(), state["moves"].copy()
