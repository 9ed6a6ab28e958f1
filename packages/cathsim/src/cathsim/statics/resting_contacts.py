"""What is read from a simulated device at rest: its contacts, their sums, and how far it lies from the curve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cathsim.simulation import Simulation
from cathsim.statics.laying import distance_to
from cathsim.statics.observed_curve import ObservedCurve

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RestingContacts:
    """Contacts of one simulated device."""

    points: Array  # on the wall, m, world frame. Shape (k, 3).
    forces: Array  # of the wall on the device, friction included, N, world frame. Shape (k, 3).
    normal_forces: Array  # part of each force along the wall's inward normal, N. Shape (k,).
    from_tip: Array  # distance of each contact from the tip along the device, m. Shape (k,).
    shape_error: float  # root mean square distance between the device and the observed curve, m

    @property
    def resultant(self) -> Array:
        """Sum of the forces, N. Shape (3,)."""
        return np.asarray(self.forces.sum(axis=0))

    @property
    def normal_sum(self) -> float:
        """Sum of the normal forces, N."""
        return float(self.normal_forces.sum())

    @property
    def largest(self) -> float:
        """Largest normal force of a contact, N; 0 without contacts."""
        return float(self.normal_forces.max(initial=0.0))


def resting_contacts(simulation: Simulation, curve: ObservedCurve) -> RestingContacts:
    """Reads the contacts of the last control step."""
    contacts = simulation.contacts()
    normals = wall_normals(simulation, contacts.points)
    return RestingContacts(
        contacts.points,
        contacts.forces,
        np.maximum((contacts.forces * normals).sum(axis=1), 0.0),
        _from_tip(simulation, contacts.points),
        distance_to(simulation, curve),
    )


def wall_normals(simulation: Simulation, points: Array) -> Array:
    """Unit normals of the wall, into the lumen, at points (k, 3) m near it. Shape (k, 3)."""
    if len(points) == 0:
        return np.empty((0, 3))
    gradient = simulation.vessel.distance(points)[1]
    return np.asarray(gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-9))


def _from_tip(simulation: Simulation, points: Array) -> Array:
    """Distance along the device from the tip to the place nearest to each point (k, 3) m. Shape (k,)."""
    nodes = simulation.inserted_points()
    starts, steps = nodes[:-1], np.diff(nodes, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    before = np.concatenate(([0.0], np.cumsum(lengths)[:-1]))
    offsets = points[:, None] - starts
    share = np.clip((offsets * steps).sum(axis=2) / lengths**2, 0.0, 1.0)
    nearest = np.argmin(np.linalg.norm(offsets - share[:, :, None] * steps, axis=2), axis=1)
    rows = np.arange(len(points))
    return np.asarray(before[nearest] + share[rows, nearest] * lengths[nearest])
