"""The scan that roadmap and history show where it is not the vessel itself: other walls, another pose."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cathsim.anatomy import Phantom

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Scan:
    """A phantom as it was scanned, turned and shifted against the patient: what a registration got wrong.

    The scan is turned about the middle of its lumen's bounding box, then shifted.
    """

    phantom: Phantom
    shift: Array  # (3,) m
    turn: Array  # (3,) rad, along the axis of the rotation

    @cached_property
    def rotation(self) -> Array:
        """The rotation from the patient to the scan. Shape (3, 3)."""
        from scipy.spatial.transform import Rotation

        return np.asarray(Rotation.from_rotvec(self.turn).as_matrix())

    @cached_property
    def middle(self) -> Array:
        """About which it is turned, m. Shape (3,)."""
        return np.asarray(self.phantom.bounds.mean(axis=0))

    def place(self, point: Array) -> Array:
        """Where the scan has a point (3,) m of the patient."""
        return np.asarray(self.rotation @ (point - self.middle) + self.middle + self.shift)

    def directions(self, axes: Array) -> Array:
        """Where directions of the patient, the columns of (3, 3), point in the scan."""
        return np.asarray(self.rotation @ axes)
